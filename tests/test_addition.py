"""A package that adds one of every kind: each is used by its name, as those of pcretrieve are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapes
from packages import install_addition
from scipy.spatial import ConvexHull

from pcretrieve import PipelineOptions, SignatureIndex, laplace_beltrami, reconstruct, signature
from pcretrieve.errors import OptionError
from pcretrieve.options import RetrievalOptions
from pcretrieve.types import SignatureTable

MESH = shapes.body(3)


@pytest.fixture(autouse=True)
def _installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install_addition(tmp_path / "site", monkeypatch)


def test_a_descriptor() -> None:
    options = PipelineOptions().changed(signature={"method": "girth", "n_values": 5})
    values = signature(MESH, options).values
    assert len(values) == 5
    assert (np.diff(values) > 0).all()


def test_an_element() -> None:
    soft, linear = (laplace_beltrami(MESH, element) for element in ("soft", "linear"))
    assert abs(2 * soft.stiffness - linear.stiffness).max() < 1e-12
    options = PipelineOptions().changed(
        spectral={"element": "soft"}, signature={"method": "shape-dna", "scale": "absolute"}
    )
    linear_options = options.changed(spectral={"element": "linear"})
    np.testing.assert_allclose(
        signature(MESH, options).values, 2 * signature(MESH, linear_options).values, rtol=1e-6
    )


def test_a_surface_method() -> None:
    scan = shapes.points_on(MESH, 4000)
    options = PipelineOptions().changed(surface={"method": "hull"})
    surface = reconstruct(scan, options)
    assert [step.stage for step in surface.provenance] == ["clean", "orient", "surface"]
    assert surface.volume == pytest.approx(ConvexHull(scan).volume, rel=0.02)
    assert signature(scan, options).deviation is None


def test_a_distance() -> None:
    values = np.exp(np.random.default_rng(0).normal(size=(50, 4)))
    ids = tuple(f"shape{number:02}" for number in range(50))
    index = SignatureIndex(SignatureTable(ids, values, "x"), RetrievalOptions(distance="largest"))
    nearest = index.query(values[7], 5)
    gaps = np.abs(np.log(values) - np.log(values[7])).max(axis=1)
    assert nearest.ids == tuple(ids[row] for row in np.argsort(gaps)[:5])
    np.testing.assert_array_equal(nearest.distances, np.sort(gaps)[:5])


def test_without_the_package_its_names_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    for stage, name in {
        "surface": "method",
        "signature": "method",
        "spectral": "element",
        "retrieval": "distance",
    }.items():
        with pytest.raises(
            OptionError, match=rf"in \[{stage}\], {name}: input should be one of .*, got 'soft'"
        ):
            PipelineOptions().changed(**{stage: {name: "soft"}})
