"""Elements of other packages: what their records declare, and what their functions may not do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapes
from packages import install

from pcretrieve import PipelineOptions
from pcretrieve.errors import InputError, OptionError, ShapeError, Stage
from pcretrieve.pipeline.process import process
from pcretrieve.spectral import Element, laplace_beltrami

MODULE = """
from math import nan

from pcretrieve.spectral import ELEMENTS, Element

cloud = ELEMENTS["points"].assemble
mesh = ELEMENTS["linear"].assemble

CLOUD = Element("cloud", cloud, needs="points", masses=("consistent",))
BROKEN = Element("broken", lambda surface: mesh(surface)[3])
EMPTY = Element("empty", lambda surface: None)
WEIGHTLESS = Element("weightless", lambda surface: mesh(surface)._replace(mass=mesh(surface).mass * nan))
"""
NAMES = ("cloud", "broken", "empty", "weightless")
ENTRY_POINTS = "[pcretrieve.elements]\n" + "".join(f"{name} = theirs:{name.upper()}\n" for name in NAMES)


@pytest.fixture(autouse=True)
def _installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path / "site", "theirs", {"theirs": MODULE}, ENTRY_POINTS, monkeypatch)


def test_an_element_of_points_needs_no_surface() -> None:
    points = shapes.points_on(shapes.body(), 3000)
    options = PipelineOptions().changed(spectral={"element": "cloud"})
    shape = process(points, options)
    assert Stage.SURFACE.value not in [step.stage for step in shape.provenance]
    lumped = process(points, options.changed(spectral={"element": "points"}))
    np.testing.assert_allclose(shape.area, lumped.area)
    assert not np.array_equal(shape.spectrum.eigenvalues, lumped.spectrum.eigenvalues)
    with pytest.raises(OptionError, match="element 'cloud' has boundary='neumann' only"):
        laplace_beltrami(points, "cloud", boundary="dirichlet")
    with pytest.raises(OptionError, match="element 'cloud' has consistent mass only, got mass='lumped'"):
        laplace_beltrami(points, "cloud", mass="lumped")
    with pytest.raises(InputError, match=r"element 'cloud' needs a PointCloud or an \(n, 3\) array, got"):
        laplace_beltrami(shapes.icosphere(2), "cloud")


@pytest.mark.parametrize(
    ("element", "message"),
    [
        ("broken", "failed, IndexError: tuple index out of range"),
        ("empty", "failed, TypeError: an element must give an Assembled, got None"),
        ("weightless", "failed, InputError: stiffness and mass must be finite, got NaN or infinite entries"),
    ],
)
def test_an_element_that_fails_fails_its_shape(element: str, message: str) -> None:
    with pytest.raises(
        ShapeError, match=f"the element '{element}' of the package theirs {message}"
    ) as raised:
        laplace_beltrami(shapes.tetrahedron(), element)
    assert raised.value.stage == Stage.SPECTRUM


def test_records_that_declare_what_does_not_exist() -> None:
    with pytest.raises(OptionError, match="needs of an element must be 'mesh' or 'points', got 'voxels'"):
        Element("x", lambda surface: surface, needs="voxels")  # type: ignore[arg-type]
    with pytest.raises(OptionError, match=r"masses of an element must be one or both of .* got \(\)"):
        Element("x", lambda surface: surface, masses=())
