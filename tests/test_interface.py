"""Python, the command line and a page give the same answer to the same question."""

from __future__ import annotations

import csv
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import shapes
from commands import result, run

import pcretrieve as pr
from pcretrieve.errors import InputError

MESHES = {
    "ball-0": shapes.ellipsoid((1, 1, 0.9), 3),
    "ball-1": shapes.ellipsoid((1, 0.95, 0.9), 3),
    "egg-0": shapes.ellipsoid((1, 0.6, 0.5), 3),
    "egg-1": shapes.ellipsoid((1, 0.6, 0.55), 3),
    "ring-0": shapes.torus(24, 12),
}
LABELS = {name: name.split("-")[0] for name in MESHES}
SHORT = {"signature": {"n_values": 15}}


@pytest.fixture(scope="session")
def catalogue(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bodies")
    for name, mesh in MESHES.items():
        pr.write_mesh(mesh, folder / f"{name}.off")
    path = folder / "bodies.sqlite"
    summary = pr.ingest(folder, path, labels=LABELS, options=SHORT, workers=1)
    assert sorted(record.id for record in summary.done) == sorted(LABELS)
    return path


def test_a_question_has_one_answer(catalogue: Path, tmp_path: Path) -> None:
    """By Python, by the command, on the page that each of them writes, and by a distance matrix."""
    scan = catalogue.with_name("egg-0.off")
    for whitening in ("none", "pca", "within-class"):
        options = {"retrieval": {"whitening": whitening}}
        neighbors = pr.search(catalogue, scan, k=3, options=options)
        assert neighbors.ids[0] == "egg-0"
        asked = (scan, "-c", catalogue, "-k", 3, "--whitening", whitening)
        (answer,) = result("query", *asked, "--html", tmp_path / "command.html")
        assert [row["id"] for row in answer["results"]] == list(neighbors.ids)
        assert [row["distance"] for row in answer["results"]] == neighbors.distances.tolist()
        page = pr.query_page(catalogue, scan, tmp_path / "python.html", k=3, options=options)
        text = page.read_text(encoding="utf-8")
        assert text == (tmp_path / "command.html").read_text(encoding="utf-8")
        assert all(shape_id in text for shape_id in neighbors.ids)
        ((name, same),) = pr.search_many(catalogue, [scan], k=3, options=options)
        assert (name, same.neighbors.ids) == (str(scan), neighbors.ids)  # type: ignore[union-attr]
        pr.write_matrix(pr.matrix(catalogue, options=options), tmp_path / "run.npy")
        (by_matrix,) = result("query", scan, "-c", catalogue, "-k", 3, "--matrix", tmp_path / "run.npy")
        assert [row["id"] for row in by_matrix["results"]] == list(neighbors.ids)


def test_measures_are_the_same_numbers(catalogue: Path, tmp_path: Path) -> None:
    for whitening in ("none", "pca"):
        printed = result("evaluate", "-c", catalogue, "--whitening", whitening, "--per-class")
        found = pr.evaluate(catalogue, options={"retrieval": {"whitening": whitening}})
        names = [part.name for part in fields(pr.RetrievalMeasures)]
        assert {name: printed[name] for name in names} == {name: getattr(found, name) for name in names}
        assert printed["macro"]["map"] == found.macro.map
        assert [one["label"] for one in printed["classes"]] == [one.label for one in found.classes]
        assert list(printed["interval"]["low"].values()) == found.interval[0].tolist()
    with pr.Catalogue(catalogue) as store:
        assert pr.evaluate(store.signatures(), options=store.options) == pr.evaluate(store)
    page = pr.report(catalogue, tmp_path / "bodies.html", k=2)
    run("report", "-c", catalogue, "-o", tmp_path / "same.html", "-k", 2)
    assert page.read_text(encoding="utf-8") == (tmp_path / "same.html").read_text(encoding="utf-8")


def test_a_metric_of_labelled_scans_is_used_in_another_catalogue(catalogue: Path, tmp_path: Path) -> None:
    """Balls that differ in one direction: in another catalogue, that direction counts less."""
    metric, other = tmp_path / "metric.npz", tmp_path / "other.sqlite"
    (tmp_path / "scans").mkdir()
    for name in ("egg-0", "egg-1", "ring-0"):
        pr.write_mesh(MESHES[name], tmp_path / "scans" / f"{name}.off")
    pr.ingest(tmp_path / "scans", other, options=SHORT, workers=1)
    reason = result("calibrate", "-c", catalogue, "-o", metric)["reason"]
    learnt = pr.calibrate(catalogue, tmp_path / "again.npz")
    assert (learnt.reason, reason) == ("within-class: 2 classes of 4 shapes",) * 2
    assert (tmp_path / "again.npz").read_bytes() == metric.read_bytes()
    chosen = {"retrieval": {"calibration": str(metric)}}
    with pr.Catalogue(other) as store:
        used = store.whitening(store.options.changed(**chosen))
    np.testing.assert_array_equal(used.matrix, learnt.matrix)
    assert (used.kind, used.reason) == ("calibrated", f"{reason}, from {metric}")
    (found,) = result("query", "egg-0", "-c", other, "--whitening", metric)
    neighbors = pr.search(other, "egg-0", options=chosen)
    assert [row["distance"] for row in found["results"]] == neighbors.distances.tolist()
    plain = result("query", "egg-0", "-c", other, "--whitening", "none")
    assert found["results"] != plain[0]["results"]
    evaluated = result("evaluate", "-c", catalogue, "--whitening", metric)
    assert evaluated["whitening_used"] == f"{reason}, from {metric}"
    pr.calibrate(catalogue, metric, options={"signature": {"n_values": 9}})
    with pytest.raises(InputError, match="must be fitted on signatures made by the same options"):
        pr.search(catalogue, "egg-0", options=chosen)
    for content in (b"", b"PK no archive", b"words"):
        metric.write_bytes(content)
        with pytest.raises(InputError, match="a whitening must be a name such as auto, or a file"):
            pr.search(catalogue, "egg-0", options=chosen)


def test_signatures_are_exported(catalogue: Path, tmp_path: Path) -> None:
    with pr.Catalogue(catalogue) as store:
        wanted = store.signatures().select(["egg-1", "ball-0"])
    for suffix in (".npz", ".parquet", ".csv"):
        path = tmp_path / f"bodies{suffix}"
        run("export", "--signatures", "-c", catalogue, "-o", path, "egg-1", "ball-0")
        if suffix == ".npz":
            with np.load(path, allow_pickle=False) as file:
                ids, labels, values = file["ids"].tolist(), file["labels"].tolist(), file["values"]
                assert str(file["kind"]) == "combined"
        elif suffix == ".parquet":
            pandas = pytest.importorskip("pandas")
            frame = pandas.read_parquet(path)
            ids, labels, values = frame["id"].tolist(), frame["label"].tolist(), frame.iloc[:, 2:].to_numpy()
        else:
            with path.open(newline="", encoding="utf-8") as text:
                header, *rows = csv.reader(text)
            assert header[:3] == ["id", "label", "v1"]
            ids, labels = [row[0] for row in rows], [row[1] for row in rows]
            values = np.array([row[2:] for row in rows], dtype=float)
        assert (ids, labels) == (["egg-1", "ball-0"], ["egg", "ball"])
        np.testing.assert_array_equal(values, wanted.values)
    with pytest.raises(InputError, match=r"must end in one of \.npz \.parquet \.csv, got bodies\.txt"):
        pr.write_signatures(wanted, tmp_path / "bodies.txt")
    with pytest.raises(InputError, match="there is no signature of the shape 'cat'"):
        wanted.select(["cat"])
