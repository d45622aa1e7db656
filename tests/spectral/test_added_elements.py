"""Elements of one's own: what their records declare, and what their functions may not do."""

from __future__ import annotations

from math import nan

import numpy as np
import pytest
import shapes

from pcretrieve.errors import InputError, OptionError, ShapeError, Stage
from pcretrieve.spectral import ELEMENTS, Element, laplace_beltrami

linear = ELEMENTS["linear"].assemble
SOFT = Element("soft", lambda mesh: linear(mesh)._replace(stiffness=(linear(mesh).stiffness * 0.5).tocsc()))
CLOUD = Element("cloud", ELEMENTS["points"].assemble, needs="points", masses=("consistent",))
WEIGHTLESS = Element("weightless", lambda mesh: linear(mesh)._replace(mass=linear(mesh).mass * nan))


def test_an_element_is_passed_as_an_object() -> None:
    mesh = shapes.body(3)
    soft, own = (laplace_beltrami(mesh, element) for element in (SOFT, "linear"))
    assert abs(2 * soft.stiffness - own.stiffness).max() < 1e-12


def test_an_element_has_what_it_declares_only() -> None:
    points = shapes.points_on(shapes.body(), 3000)
    lumped = laplace_beltrami(points, "points")
    np.testing.assert_allclose(laplace_beltrami(points, CLOUD).mass.sum(), lumped.mass.sum())
    with pytest.raises(OptionError, match="element 'cloud' has boundary='neumann' only"):
        laplace_beltrami(points, CLOUD, boundary="dirichlet")
    with pytest.raises(OptionError, match="element 'cloud' has consistent mass only, got mass='lumped'"):
        laplace_beltrami(points, CLOUD, mass="lumped")
    with pytest.raises(InputError, match=r"element 'cloud' needs a PointCloud or an \(n, 3\) array, got"):
        laplace_beltrami(shapes.icosphere(2), CLOUD)
    with pytest.raises(OptionError, match=r"element must be 'linear', .* or 'points', got 'cloud'"):
        laplace_beltrami(points, "cloud")


def test_matrices_that_are_not_finite_fail_the_shape() -> None:
    with pytest.raises(ShapeError, match="stiffness and mass must be finite, got NaN or") as raised:
        laplace_beltrami(shapes.tetrahedron(), WEIGHTLESS)
    assert raised.value.stage == Stage.SPECTRUM


def test_records_that_declare_what_does_not_exist() -> None:
    with pytest.raises(OptionError, match="needs of an element must be 'mesh' or 'points', got 'voxels'"):
        Element("x", linear, needs="voxels")  # type: ignore[arg-type]
    with pytest.raises(OptionError, match=r"masses of an element must be one or both of .* got \(\)"):
        Element("x", linear, masses=())
