"""The examples of CONTRIBUTING.md are installed as a package, and used."""

from __future__ import annotations

import re
import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import shapes
from packages import install

import pcretrieve as pr
from pcretrieve.catalogue.arrays import packed_values
from pcretrieve.catalogue.settings import settings_of
from pcretrieve.catalogue.sqlite import SqliteRows
from pcretrieve.matching import MATCHERS, PairwiseIndex
from pcretrieve.types import TriangleMesh

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

TEXT = (Path(__file__).parents[1] / "CONTRIBUTING.md").read_text(encoding="utf-8")
PYTHON_BLOCKS = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)
(METADATA,) = re.findall(r"```toml\n(.*?)```", TEXT, re.DOTALL)

# Blocks that begin with this line make up a module of another package; the others run.
MODULE = "# other_package.py\n"


def entry_points() -> str:
    """The entry points of the example, in the format of installed metadata."""
    groups = tomllib.loads(METADATA)["project"]["entry-points"]
    lines = []
    for group, points in groups.items():
        lines += [f"[{group}]", *(f"{name} = {value}" for name, value in points.items())]
    return "\n".join(lines)


def write_tri(path: Path, mesh: TriangleMesh) -> None:
    np.savetxt(path, mesh.vertices[mesh.faces].reshape(-1, 9))


@pytest.fixture
def names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, object]:
    """What the blocks define, after they ran in order with the package installed."""
    module = "".join(block for block in PYTHON_BLOCKS if block.startswith(MODULE))
    install(tmp_path / "site", "other_package", {"other_package": module}, entry_points(), monkeypatch)
    monkeypatch.chdir(tmp_path)
    body = shapes.body(3)
    write_tri(tmp_path / "body.tri", body)
    write_tri(tmp_path / "thin.tri", TriangleMesh(body.vertices * [1, 1, 0.4], body.faces))
    found: dict[str, object] = {}
    for block in PYTHON_BLOCKS:
        if not block.startswith(MODULE):
            exec(compile(block, "CONTRIBUTING.md", "exec"), found)
    return found


def test_the_examples_run(names: dict[str, object]) -> None:
    """The added format, element, descriptor and distance made and searched a catalogue; then the rest."""
    with pr.Catalogue("bodies.sqlite") as catalogue:
        table, options = catalogue.signatures(), catalogue.options
        assert table.values.shape == (2, 5)
        index = PairwiseIndex(MATCHERS["girth"], table.ids, catalogue.shape)
        assert index.nearest("thin").ids == ("thin", "body")
    copy = names["copy"]
    assert callable(copy)
    packed = {name: packed_values(values) for name, values in zip(table.ids, table.values, strict=True)}
    with (
        closing(SqliteRows(Path("bodies.sqlite"), settings_of(options), create=False)) as source,
        closing(SqliteRows(Path("copy.sqlite"), settings_of(options), create=True)) as target,
    ):
        copy(source, target, packed)
    with pr.Catalogue("bodies.sqlite") as catalogue, pr.Catalogue("copy.sqlite") as copied:
        assert copied.records() == catalogue.records()
        assert copied.signatures() == table
        for name in table.ids:
            assert copied.shape(name) == catalogue.shape(name)
