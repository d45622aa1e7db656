"""Layouts of published sets: the classes of their files, their counts, and where they are published."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from pcretrieve.errors import BenchmarkError, InputError
from pcretrieve.evaluation import MEASURES, PUBLISHED
from pcretrieve.ingestion.labels import LAYOUTS, discover_labelled, labels_of, match_labels

DATA = Path(__file__).parents[2].parent / "shared" / "data"


@pytest.mark.parametrize(
    ("layout", "path", "label"),
    [
        ("tosca", "/sets/tosca/cat10.off", "cat"),
        ("tosca", "/sets/tosca/victoria0.mat", "victoria"),
        ("tosca", "/sets/tosca/readme.off", None),
        ("faust", "/MPI-FAUST/training/scans/tr_scan_009.ply", "person0"),
        ("faust", "/MPI-FAUST/training/registrations/tr_reg_090.ply", "person9"),
        ("faust", "/MPI-FAUST/test/scans/test_scan_000.ply", None),
        ("folders", "/bodies/ann/stand.ply", "ann"),
        ("folders", "/bodies/ann/parts.glb#left", "ann"),
    ],
)
def test_classes_in_names(layout: str, path: str, label: str | None) -> None:
    other = {"tosca": "/x/dog1.off", "faust": "/x/tr_reg_050.ply", "folders": "/x/bob/walk.ply"}[layout]
    expected = {path: label} if label is not None else {}
    found = labels_of(layout, [path, other])
    assert {name: found[name] for name in found.keys() - {other}} == expected
    assert other in found


@pytest.mark.parametrize("layout", ["faust", "tosca"])
def test_a_whole_set_has_its_counts(layout: str, caplog: pytest.LogCaptureFixture) -> None:
    sizes = {"cat": 11, "dog": 9, "wolf": 3, "horse": 8, "centaur": 6, "gorilla": 4, "victoria": 12}
    sizes |= {"david": 7, "michael": 20}
    files = {
        "faust": [f"/f/tr_reg_{number:03}.ply" for number in range(100)],
        "tosca": [f"/t/{name}{number}.off" for name, n in sizes.items() for number in range(n)],
    }[layout]
    with caplog.at_level(logging.WARNING, "pcretrieve"):
        assert len(labels_of(layout, files)) == len(files)
        assert not caplog.records
        labels_of(layout, files[1:])
    assert f"of which {len(files) - 1} in" in caplog.text
    assert LAYOUTS[layout].published in caplog.text


def write(path: Path, text: str = "") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def test_a_label_file_beside_the_scans_or_above(tmp_path: Path) -> None:
    """Two sets have one each, so that the same numbers are told apart."""
    scans = []
    for track in ("Real", "Synthetic"):
        write(tmp_path / track / "test.cla", f"PSB 1\n2 3\n\n{track}-a 0 2\n0\n1\n\n{track}-b 0 1\n2\n")
        scans += [write(tmp_path / track / "Data" / f"{number}.obj") for number in range(3)]
    found = labels_of("psb", scans)
    assert [found[str(path)] for path in scans] == [
        *("Real-a", "Real-a", "Real-b"),
        *("Synthetic-a", "Synthetic-a", "Synthetic-b"),
    ]
    write(tmp_path / "Real" / "train.cla", "PSB 1\n0 0\n")
    with pytest.raises(BenchmarkError, match=r"needs one label file in .*Real, got test\.cla, train\.cla"):
        labels_of("psb", scans)


def test_labels_csv_beside_the_scans(tmp_path: Path) -> None:
    scans = [write(tmp_path / name) for name in ("a.ply", "b.ply", "c.ply")]
    with pytest.raises(
        BenchmarkError, match=r"its classes in labels\.csv, which is not in .*, nor in the two"
    ):
        labels_of("csv", scans)
    write(tmp_path / "labels.csv", "file,class\na.ply,X\nb.ply,Y\nelsewhere.ply,Y\n")
    assert labels_of("csv", scans) == {str(scans[0]): "X", str(scans[1]): "Y"}


def test_a_file_is_named_with_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "tosca", "file,class\nx.ply,X\n")
    assert labels_of("./tosca", ["/x.ply"]) == {"x.ply": "X"}
    with pytest.raises(BenchmarkError, match=r"one of the layout tosca \(published at http"):
        labels_of("tosca", ["/x.ply"])


def test_a_set_that_is_missing_is_published_somewhere(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"published at https://www\.itl\.nist\.gov/"):
        discover_labelled([tmp_path / "shrec11"], "shrec11")
    write(tmp_path / "T0.obj")
    with pytest.raises(BenchmarkError, match=r"test\.cla or labels\.csv, .* \(published at https://www\.itl"):
        discover_labelled([tmp_path / "T0.obj"], "shrec11")


def test_published_measures_are_of_layouts() -> None:
    assert PUBLISHED.keys() <= LAYOUTS.keys()
    for rows in PUBLISHED.values():
        for row in rows:
            assert len(row.measures) == len(MEASURES)
            assert all(value is None or 0 < value <= 1 for value in row.measures)


def test_one_label_file_for_two_sets_is_refused() -> None:
    """The numbers are ids in the set that was ingested first; the other one got the next free ids."""
    paths = {"0": "/Real/0.obj", "1": "/Real/1.obj", "0-2": "/Synthetic/0.obj", "1-2": "/Synthetic/1.obj"}
    numbers = {"0": "ann", "1": "bob"}
    with pytest.raises(
        BenchmarkError, match=r"'0' stands for 2, such as /Real/0\.obj, /Synthetic/0\.obj: write"
    ):
        match_labels(numbers, paths)
    both = numbers | {"0-2": "cyd", "1-2": "dan"}
    assert match_labels(both, paths) == (both, [])


@pytest.mark.skipif(not DATA.is_dir(), reason="needs SHREC'11 beside the checkout, in ../shared/data")
def test_shrec11_is_whole(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, "pcretrieve"):
        scans, labels = discover_labelled([DATA / "shrec11"], "shrec11")
    assert len(scans) == len(labels) == 600
    assert not caplog.records
