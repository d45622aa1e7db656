"""The bench of scan fidelity runs, and its columns stay what they are."""

from __future__ import annotations

import csv
import json
import math
import runpy
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[1] / "scripts" / "benchmark_fidelity"


def bench(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, SCRIPT, *arguments], capture_output=True, text=True)


def test_two_bodies_are_scanned_and_held_against_the_truth(tmp_path: Path) -> None:
    pytest.importorskip("skimage", reason="bodies are made with scikit-image")
    table = tmp_path / "rows.csv"
    ended = bench(
        "--set", "humans", "--limit", "2", "--workers", "2", "--name", "preset", "--csv", str(table)
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


def test_the_last_of_a_spread_is_the_last() -> None:
    script = runpy.run_path(str(SCRIPT))
    assert script["spread"]("abcdefghij", 4) == [(0, "a"), (3, "d"), (6, "g"), (9, "j")]
    assert script["spread"]("ab", 5) == [(0, "a"), (1, "b")]
    assert script["spread"]("abc", None) == list(enumerate("abc"))


def test_the_columns_are_stable() -> None:
    """Rows of different days share a file: new columns go to the end, and this list grows."""
    row = runpy.run_path(str(SCRIPT))["Row"]
    assert " ".join(field.name for field in fields(row)) == (
        "set condition name digest scans failed normals_right closed euler_right distance_mean "
        "distance_hausdorff log_error_median log_error_mean nn map nn_within map_within clean_nn clean_map "
        "clean_nn_within clean_map_within seconds stages peak_mib rescan_spread textbook_seconds "
        "textbook_ratio nn_relative map_relative nn_pca map_pca clean_nn_relative clean_map_relative "
        "clean_nn_pca clean_map_pca nn_resolution map_resolution clean_nn_resolution clean_map_resolution "
        "nn_sized map_sized clean_nn_sized clean_map_sized"
    )


def test_names_that_do_not_fit_the_configurations_are_refused() -> None:
    ended = bench("--name", "one", "--name", "two")
    assert ended.returncode == 1
    assert "distinct names, one for each, got one, two" in ended.stderr
