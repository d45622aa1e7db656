"""Linear elements on a point cloud: the properties of the other elements, without a surface."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import shapes

from pcretrieve.spectral import eigenpairs, laplace_beltrami
from pcretrieve.spectral.points import stars
from pcretrieve.values import FloatArray, LaplaceBeltrami, PointCloud

SPHERE = shapes.points_on(shapes.icosphere(6), 2000)
BODY = shapes.points_on(shapes.body(5), 4000)


def on_points(points: FloatArray, **options: Any) -> LaplaceBeltrami:
    return laplace_beltrami(points, "points", **options)


@pytest.mark.parametrize(("scale", "shift"), [(1e-3, 0.0), (1.0, 10.0), (1e3, -1e4)])
def test_neither_place_nor_order_matters_and_scaling_squares_mass(
    scale: float, shift: float
) -> None:
    rng = np.random.default_rng(1)
    turn, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    moved = scale * (rng.permutation(BODY) @ turn.T + shift)
    here, there = eigenpairs(on_points(BODY), 30), eigenpairs(on_points(moved), 30)
    assert there.area == pytest.approx(scale**2 * here.area, rel=1e-3)
    # If four points are nearly cocircular, both diagonals are allowed.
    np.testing.assert_allclose(
        scale**2 * there.eigenvalues[1:], here.eigenvalues[1:], rtol=2e-4
    )


def test_no_neighbour_lies_in_the_circle_of_a_triangle() -> None:
    rng = np.random.default_rng(3)
    points = np.column_stack([rng.random((400, 2)), np.zeros(400)])
    triangles = stars(points)
    inside = np.abs(points[:, :2] - 0.5).max(axis=1) < 0.3
    a, b, c = points[triangles[inside[triangles].all(axis=1)]].transpose(1, 0, 2)
    # Centre of the circle, from |x − a|² = |x − b|² = |x − c|²
    sides = 2 * np.stack([b - a, c - a], axis=1)[:, :, :2]
    lengths = np.stack([(b**2 - a**2).sum(axis=1), (c**2 - a**2).sum(axis=1)], axis=1)
    centre = np.linalg.solve(sides, lengths[:, :, None])[:, :, 0]
    radius = np.linalg.norm(centre - a[:, :2], axis=1)
    nearest = np.linalg.norm(centre[:, None] - points[:, :2], axis=2).min(axis=1)
    assert (nearest > radius * (1 - 1e-6)).mean() > 0.99


@pytest.mark.parametrize(
    ("points", "area"), [(SPHERE, 4 * np.pi), (BODY, shapes.body(5).area)]
)
def test_the_mass_is_the_area_of_the_surface_that_was_sampled(
    points: FloatArray, area: float
) -> None:
    assert on_points(points).area == pytest.approx(area, rel=0.01)


def test_eigenvalues_of_the_sphere_converge_at_order_two() -> None:
    exact = np.array(
        [degree * (degree + 1) for degree in range(5) for _ in range(2 * degree + 1)]
    )[1:]
    sizes = (500, 2000, 8000)  # the spacing halves
    errors = []
    for n in sizes:
        # Random samples scatter about the trend; a spiral of equal areas does not.
        height = 1 - (2 * np.arange(n) + 1) / n
        angle = np.pi * (1 + np.sqrt(5)) * np.arange(n)
        ring = np.sqrt(1 - height**2)
        spiral = np.column_stack([ring * np.cos(angle), ring * np.sin(angle), height])
        errors.append(
            np.abs(eigenpairs(on_points(spiral), 25).eigenvalues[1:] / exact - 1).max()
        )
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(rates, 2, atol=0.4)
    assert errors[-1] < 0.005


def test_normals_keep_the_sides_of_a_thin_limb_apart() -> None:
    # The distance of two sheets is less than the spacing of their points: only normals separate them.
    rng = np.random.default_rng(0)
    sheet = np.column_stack([rng.random((1000, 2)), np.zeros(1000)])
    other = np.column_stack([rng.random((1000, 2)), np.full(1000, 0.01)])
    up = np.tile([0.0, 0, 1], (1000, 1))
    points = np.concatenate([sheet, other])
    apart = laplace_beltrami(PointCloud(points, np.concatenate([-up, up])), "points")
    assert on_points(points).n_components == 1
    assert apart.n_components == 2
    assert apart.area == pytest.approx(
        2, rel=0.2
    )  # half of the neighbours that there could be
