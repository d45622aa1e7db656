"""The examples of CONTRIBUTING.md are installed as a package, and used."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapes
from packages import SCRIPTS, install_contributed

import pcretrieve as pr
from pcretrieve.matching import MATCHERS, PairwiseIndex
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
    """The added format, stages, element, descriptor, distance, executor and store make catalogues."""
    with pr.Catalogue("bodies.sqlite") as catalogue, pr.Catalogue("other.sqlite") as other:
        table, options = catalogue.signatures(), catalogue.options
        assert other.signatures() == table
        assert other.shape("body") == catalogue.shape("body")
        assert table.values.shape == (2, 5)
        index = PairwiseIndex(MATCHERS["girth"], table.ids, catalogue.shape)
        assert index.nearest("thin").ids == ("thin", "body")
        stages = [step.stage for step in catalogue.record("body").steps]
        assert stages == ["read", "topology", "near", "smooth", "spectrum", "checks"]  # a mesh that is kept
    points = shapes.points_on(shapes.body(3), 3000)
    surface = pr.reconstruct(np.concatenate([points, points[:20] + 20]), options)
    assert [step.stage for step in surface.provenance] == ["near", "clean", "orient", "surface", "smooth"]
    assert surface.provenance[0].sizes == {"points_in": 3020, "points": 3000}
