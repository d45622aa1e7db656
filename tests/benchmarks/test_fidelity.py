"""The benchmark of fidelity runs, and the columns of its CSV file stay what they are."""

from __future__ import annotations

import csv
import json
import math
import subprocess
import sys
from dataclasses import asdict, fields
from pathlib import Path

import numpy as np
import pytest
import shapes

from pcretrieve.benchmarks.fidelity.conditions import CONDITIONS, write_scan
from pcretrieve.benchmarks.fidelity.examination import N_VALUES, examine
from pcretrieve.benchmarks.fidelity.main import main
from pcretrieve.benchmarks.fidelity.row import NAN, TABLE, Row, append, relative_spread
from pcretrieve.benchmarks.fidelity.textbook import textbook_seconds
from pcretrieve.errors import BenchmarkError
from pcretrieve.formats import read_scan
from pcretrieve.options import PipelineOptions
from pcretrieve.values import PointCloud, TriangleMesh

SCRIPT = Path(__file__).parents[2] / "scripts" / "benchmark_fidelity"


def test_two_bodies_are_scanned_and_held_against_the_truth(tmp_path: Path) -> None:
    table = tmp_path / "rows.csv"
    ended = subprocess.run(
        [
            *(sys.executable, SCRIPT, "--set", "humans", "--limit", "2", "--workers", "2"),
            *("--name", "preset", "--csv", table),
        ],
        capture_output=True,
        text=True,
    )
    assert ended.returncode == 0, ended.stderr
    assert "typical-uniform" in ended.stdout
    with table.open(newline="", encoding="utf-8") as file:
        (row,) = csv.DictReader(file)
    assert (row["set"], row["condition"], row["name"]) == ("humans", "typical-uniform", "preset")
    assert (row["scans"], row["failed"]) == ("2", "0")
    assert float(row["closed"]) == 1
    assert 0.9 < float(row["normals_right"]) <= 1
    assert 0 < float(row["distance_mean"]) < 0.003 < float(row["distance_hausdorff"]) < 0.1
    assert 0 < float(row["log_error_median"]) < 0.5
    assert math.isnan(float(row["nn"])), "two subjects, one body each: there is no neighbour to find"
    assert float(row["seconds"]) > 0
    assert {"clean", "orient", "surface"} <= set(json.loads(row["stages"]))


@pytest.mark.parametrize("condition", CONDITIONS)
def test_every_condition_gives_what_its_name_says(tmp_path: Path, condition: str) -> None:
    body = shapes.body(3)
    scan = read_scan(write_scan(tmp_path / "body", body, condition, np.random.default_rng(0)))
    if condition == "defects":
        assert isinstance(scan, TriangleMesh)
        assert len(scan.faces) != len(body.faces)
    else:
        assert isinstance(scan, PointCloud)
        assert (scan.viewpoints is not None) == condition.endswith("sensors")


def test_a_clean_mesh_examined_against_itself_is_without_fault(tmp_path: Path) -> None:
    """A mesh that is kept as it is has the distance of rounding to the truth, and no points to judge."""
    mesh = shapes.body(3)
    path = tmp_path / "body.off"
    path.write_text(
        f"OFF\n{len(mesh.vertices)} {len(mesh.faces)} 0\n"
        + "".join("{:.17g} {:.17g} {:.17g}\n".format(*vertex) for vertex in mesh.vertices.tolist())
        + "".join("3 {} {} {}\n".format(*face) for face in mesh.faces.tolist())
    )
    options = PipelineOptions().changed(
        surface={"mode": "keep"}, signature={"method": "r-bihdm", "n_values": N_VALUES}
    )
    found = examine(path, mesh, options)
    assert found.closed
    assert found.euler == 2
    assert found.normals is None
    assert found.hausdorff < 1e-5
    assert [len(values) for values in found.signatures] == [23, 23, 60, 24]


def test_the_textbook_pipeline_begins_with_points(tmp_path: Path) -> None:
    path = write_scan(tmp_path / "body", shapes.body(2), "defects", np.random.default_rng(0))
    with pytest.raises(BenchmarkError, match="begins with points, got a mesh"):
        textbook_seconds(path, timeout=60)


def test_the_spread_of_rescans_is_relative_to_the_nearest_other_class() -> None:
    """Log-signatures of one value: 0 and 2 of one body, and classes at 0, 3 and 10."""
    repeats = [[np.exp([0.0]), np.exp([2.0])]]
    values = np.exp([[0.0], [3.0], [10.0]])
    assert relative_spread(repeats, values, ["a", "b", "c"]) == pytest.approx(1 / 3)
    assert math.isnan(relative_spread([], values, ["a", "b", "c"]))


def test_the_columns_are_stable() -> None:
    """Rows of different days share a file: new columns go to the end, and this list grows."""
    assert " ".join(field.name for field in fields(Row)) == (
        "set condition name digest scans failed normals_right closed euler_right distance_mean "
        "distance_hausdorff log_error_median log_error_mean nn map nn_within map_within clean_nn clean_map "
        "clean_nn_within clean_map_within seconds stages peak_mib rescan_spread textbook_seconds "
        "textbook_ratio nn_relative map_relative nn_pca map_pca clean_nn_relative clean_map_relative "
        "clean_nn_pca clean_map_pca nn_resolution map_resolution clean_nn_resolution clean_map_resolution "
        "nn_sized map_sized clean_nn_sized clean_map_sized processor_seconds"
    )


def test_rows_are_printed_and_appended_below_one_header(tmp_path: Path) -> None:
    numbers = {field.name: NAN for field in fields(Row) if field.type == "float"}
    words = {
        "set": "tosca",
        "condition": "defects",
        "name": "mine",
        "digest": "0",
        "stages": '{"clean": 0.25}',
    }
    row = Row(**words, scans=3, failed=1, **numbers | {"nn": 0.5})  # type: ignore[arg-type]
    first, *_, last = row.lines()
    assert len(first) <= len(TABLE.head)
    assert first.split()[:4] == ["defects", "mine", "3", "1"]
    assert last == "    clean 0.25 s (100.0%)"
    for _ in range(2):
        append(tmp_path / "rows.csv", row)
    with (tmp_path / "rows.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [found["nn"] for found in rows] == ["0.5", "0.5"]
    assert set(rows[0]) == set(asdict(row))


def test_names_that_do_not_fit_the_configurations_are_refused() -> None:
    with pytest.raises(SystemExit, match="distinct names, one for each, got one, two"):
        main(["--name", "one", "--name", "two", "--workers", "2"])


def test_a_set_that_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="cannot read the label file"):
        main(["--set", "tosca", "--data", str(tmp_path), "--workers", "2"])
