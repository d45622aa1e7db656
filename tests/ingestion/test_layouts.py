"""Layouts of published sets: the classes of their files, their counts, and where they are published."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcretrieve.errors import BenchmarkError
from pcretrieve.ingestion.labels import labels_of, match_labels


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
