"""Sets of meshes are read as a whole or in part; missing sets are reported."""

from __future__ import annotations

from pathlib import Path

import pytest
import shapes

from pcretrieve.benchmarks.sets import SETS, left_out, read_mesh, spread
from pcretrieve.errors import BenchmarkError
from pcretrieve.formats import write_mesh
from pcretrieve.ingestion.layouts import LAYOUTS
from pcretrieve.simulation import write_ply


def test_the_last_of_a_spread_is_the_last() -> None:
    assert spread("abcdefghij", 4) == [(0, "a"), (3, "d"), (6, "g"), (9, "j")]
    assert spread("ab", 5) == [(0, "a"), (1, "b")]
    assert spread("abc", None) == list(enumerate("abc"))


def test_a_set_without_a_folder_is_left_out(tmp_path: Path) -> None:
    published = f"the set is published at {LAYOUTS['tosca'].published}"
    missing = tmp_path / "tosca"
    assert left_out("drift", missing) == f"drift: left out, {missing} is not there; {published}"
    assert left_out("drift", tmp_path) is None


def test_tosca_is_read_with_its_labels(tmp_path: Path) -> None:
    folder = tmp_path / "tosca"
    folder.mkdir()
    for number in range(4):
        write_mesh(shapes.ellipsoid((1, 1, 1 + number), subdivisions=1), folder / f"egg{number}.off")
    lines = [f"egg{number}.off,kind{number // 2}" for number in range(4)]
    (folder / "labels.csv").write_text("\n".join(["file,class", *lines]))
    items = SETS["tosca"](tmp_path, 2)
    assert [(item.number, item.name, item.label) for item in items] == [
        (0, "egg0", "kind0"),
        (3, "egg3", "kind1"),
    ]
    assert items[1].mesh.diagonal > items[0].mesh.diagonal


def test_a_set_must_hold_meshes(tmp_path: Path) -> None:
    write_ply(tmp_path / "points.ply", shapes.icosphere(1).vertices)
    with pytest.raises(BenchmarkError, match="must hold a mesh, got points without faces"):
        read_mesh(tmp_path / "points.ply")


def test_people_are_the_same_in_every_part_of_the_set() -> None:
    """The seed of a body is its number in the whole set, not in the part that is made."""
    first, last = SETS["humans"](Path(), 2)
    assert (first.number, first.name, first.label) == (0, "person0_stand", "person0")
    assert (last.number, last.name, last.label) == (99, "person9_arms_crossed", "person9")
    assert SETS["humans"](Path(), 1)[0].mesh.area == first.mesh.area
