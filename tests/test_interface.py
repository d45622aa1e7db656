"""The functions of the front door: the same numbers as the command line, from the same request."""

import csv
import json
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
import shapes

import pcretrieve as pr
from pcretrieve.errors import InputError
from pcretrieve.values import TriangleMesh

LABELS = {"ball-0": "ball", "ball-1": "ball", "egg-0": "egg", "egg-1": "egg", "ring-0": "ring"}


def meshes() -> dict[str, TriangleMesh]:
    return {
        "ball-0": shapes.ellipsoid((1, 1, 0.9), 3),
        "ball-1": shapes.ellipsoid((1, 0.95, 0.9), 3),
        "egg-0": shapes.ellipsoid((1, 0.6, 0.5), 3),
        "egg-1": shapes.ellipsoid((1, 0.6, 0.55), 3),
        "ring-0": shapes.torus(24, 12),
    }


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bodies")
    for name, mesh in meshes().items():
        pr.write_mesh(mesh, folder / f"{name}.off")
    path = folder / "bodies.sqlite"
    summary = pr.ingest(folder, path, labels=LABELS, options={"signature": {"n_values": 15}}, workers=1)
    assert sorted(record.id for record in summary.done) == sorted(LABELS)
    return path


def command(*arguments: object) -> str:
    done = subprocess.run(
        [sys.executable, "-m", "pcretrieve", *map(str, arguments)], capture_output=True, text=True, check=True
    )
    return done.stdout


@pytest.mark.parametrize("whitening", ["none", "pca", "within-class"])
def test_a_search_is_a_query(catalogue: Path, whitening: str) -> None:
    scan = catalogue.with_name("egg-0.off")
    (answer,) = json.loads(
        command("query", scan, "-c", catalogue, "-k", 3, "--whitening", whitening, "--json")
    )["result"]
    found = answer["results"]
    neighbors = pr.search(catalogue, scan, k=3, options={"retrieval": {"whitening": whitening}})
    assert [row["id"] for row in found] == list(neighbors.ids)
    assert [row["distance"] for row in found] == neighbors.distances.tolist()
    assert neighbors.ids[0] == "egg-0"


def test_a_metric_of_labelled_scans_is_used_in_another_catalogue(catalogue: Path, tmp_path: Path) -> None:
    """Balls that differ in one direction: in another catalogue, that direction counts less."""
    metric, other = tmp_path / "metric.npz", tmp_path / "other.sqlite"
    for name in ("egg-0", "egg-1", "ring-0"):
        (tmp_path / "scans").mkdir(exist_ok=True)
        pr.write_mesh(meshes()[name], tmp_path / "scans" / f"{name}.off")
    pr.ingest(tmp_path / "scans", other, options={"signature": {"n_values": 15}}, workers=1)
    said = subprocess.run(
        [sys.executable, "-m", "pcretrieve", "calibrate", "-c", str(catalogue), "-o", str(metric)],
        capture_output=True,
        text=True,
        check=True,
    ).stderr
    assert said == f"{metric}: within-class: 2 classes of 4 shapes\n"
    with pr.Catalogue(catalogue) as store:
        labelled = store.options.changed(retrieval={"whitening": "within-class"})
        expected = store.whitening(labelled)
    chosen = {"retrieval": {"calibration": str(metric)}}
    with pr.Catalogue(other) as store:
        used = store.whitening(store.options.changed(**chosen))
    np.testing.assert_array_equal(used.matrix, expected.matrix)
    assert (used.kind, used.reason) == ("calibrated", f"within-class: 2 classes of 4 shapes, from {metric}")
    (found,) = json.loads(command("query", "egg-0", "-c", other, "--whitening", metric, "--json"))["result"]
    neighbors = pr.search(other, "egg-0", options=chosen)
    assert [row["distance"] for row in found["results"]] == neighbors.distances.tolist()
    plain = json.loads(command("query", "egg-0", "-c", other, "--whitening", "none", "--json"))["result"]
    assert found["results"] != plain[0]["results"]
    pr.calibrate(catalogue, tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == metric.read_bytes()
    evaluated = json.loads(command("evaluate", "-c", catalogue, "--whitening", metric, "--json"))["result"]
    assert evaluated["whitening_used"] == f"within-class: 2 classes of 4 shapes, from {metric}"


def test_a_metric_of_other_signatures_is_refused(catalogue: Path, tmp_path: Path) -> None:
    metric = tmp_path / "metric.npz"
    pr.calibrate(catalogue, metric, options={"signature": {"n_values": 9}})
    with pytest.raises(InputError, match="must be fitted on signatures made by the same options"):
        pr.search(catalogue, "egg-0", options={"retrieval": {"calibration": str(metric)}})
    for content in (b"", b"PK no archive", b"words"):
        metric.write_bytes(content)
        with pytest.raises(InputError, match="a whitening must be a name such as auto, or a file"):
            pr.search(catalogue, "egg-0", options={"retrieval": {"calibration": str(metric)}})
    with pytest.raises(InputError, match="a whitening must be a name such as auto, or a file"):
        pr.search(catalogue, "egg-0", options={"retrieval": {"calibration": "pac"}})


def test_what_is_no_file_is_searched_for_too(catalogue: Path) -> None:
    mesh = meshes()["egg-1"]
    wanted = pr.search(catalogue, catalogue.with_name("egg-1.off"), k=2)
    np.testing.assert_allclose(pr.search(catalogue, mesh, k=2).distances, wanted.distances, atol=1e-6)
    assert pr.search(catalogue, mesh.to_trimesh(), k=2).ids == wanted.ids
    with pr.Catalogue(catalogue) as store:
        described = pr.signature(catalogue.with_name("egg-1.off"), store.options)
        assert pr.search(store, described, k=2) == wanted


@pytest.mark.parametrize("whitening", ["none", "pca"])
def test_evaluate_is_evaluate(catalogue: Path, whitening: str) -> None:
    printed = json.loads(command("evaluate", "-c", catalogue, "--whitening", whitening, "--json"))["result"]
    measures = pr.evaluate(catalogue, options={"retrieval": {"whitening": whitening}})
    for name, value in asdict(measures).items():
        assert printed[name] == value
    assert printed["whitening"] == whitening


def test_a_table_is_evaluated_as_its_catalogue(catalogue: Path) -> None:
    with pr.Catalogue(catalogue) as store:
        assert pr.evaluate(store.signatures(), options=store.options) == pr.evaluate(store)


def test_a_report_is_a_page(catalogue: Path, tmp_path: Path) -> None:
    page = pr.report(catalogue, tmp_path / "bodies.html", k=2)
    assert page.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")


def test_inspect_writes_its_page(catalogue: Path, tmp_path: Path) -> None:
    found = pr.inspect(catalogue.with_name("egg-0.off"), n_rescans=0, page=tmp_path / "egg.html")
    assert found.verdict == "passed"
    assert "egg-0.off" in (tmp_path / "egg.html").read_text(encoding="utf-8")


def test_one_view_is_not_merged() -> None:
    with pytest.raises(InputError, match="at least"):
        pr.merge_views([shapes.body(3)])


@pytest.mark.parametrize("suffix", [".npz", ".parquet", ".csv"])
def test_signatures_are_exported(catalogue: Path, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"bodies{suffix}"
    command("export", "--signatures", "-c", catalogue, "-o", path, "egg-1", "ball-0")
    with pr.Catalogue(catalogue) as store:
        wanted = store.signatures().select(["egg-1", "ball-0"])
    if suffix == ".npz":
        with np.load(path, allow_pickle=False) as file:
            ids, labels, values = file["ids"].tolist(), file["labels"].tolist(), file["values"]
            assert str(file["kind"]) == "combined"
    elif suffix == ".parquet":
        import pandas

        frame = pandas.read_parquet(path)
        ids, labels, values = frame["id"].tolist(), frame["label"].tolist(), frame.iloc[:, 2:].to_numpy()
    else:
        with path.open(newline="", encoding="utf-8") as text:
            header, *rows = csv.reader(text)
        assert header[:3] == ["id", "label", "v1"]
        ids, labels = [row[0] for row in rows], [row[1] for row in rows]
        values = np.array([row[2:] for row in rows], dtype=float)
    assert ids == ["egg-1", "ball-0"]
    assert labels == ["egg", "ball"]
    np.testing.assert_array_equal(values, wanted.values)


def test_signatures_go_to_known_files_only(catalogue: Path, tmp_path: Path) -> None:
    with pr.Catalogue(catalogue) as store:
        table = store.signatures()
    with pytest.raises(InputError, match=r"must end in one of \.npz \.parquet \.csv, got bodies\.txt"):
        pr.write_signatures(table, tmp_path / "bodies.txt")
    with pytest.raises(InputError, match="there is no signature of the shape 'cat'"):
        table.select(["cat"])
