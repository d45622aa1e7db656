"""The examples of CONTRIBUTING.md are installed as a package, and used."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapes
from packages import SCRIPTS, install_contributed

import pcretrieve as pr
from pcretrieve.values import TriangleMesh


def write_tri(path: Path, mesh: TriangleMesh) -> None:
    np.savetxt(path, mesh.vertices[mesh.faces].reshape(-1, 9))


@pytest.fixture
def names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, object]:
    """What the scripts define, after they ran in order with the package installed."""
    install_contributed(tmp_path / "site", monkeypatch)
    monkeypatch.chdir(tmp_path)
    body = shapes.body(3)
    write_tri(tmp_path / "body.tri", body)
    write_tri(tmp_path / "thin.tri", TriangleMesh(body.vertices * [1, 1, 0.4], body.faces))
    found: dict[str, object] = {}
    for script in SCRIPTS:
        exec(compile(script, "CONTRIBUTING.md", "exec"), found)
    return found


def test_the_examples_run(names: dict[str, object]) -> None:
    """The added format and descriptor make a catalogue, which finds its shapes."""
    with pr.Catalogue("bodies.sqlite") as catalogue:
        assert catalogue.signatures().values.shape == (2, 5)
        assert catalogue.signatures().kind == "heat-trace"
