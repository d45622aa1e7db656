"""Density that varies over a body: sparse points are kept, and points are interpolated between them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from pcretrieve import PointCloud
from pcretrieve.points.density import interpolated, local_spacings, sparse_points
from pcretrieve.points.neighbors import Neighborhoods, neighborhoods, spacing
from pcretrieve.values import FloatArray

N = 20_000
CELL = 0.02  # the spacing of N points on the unit sphere is .025


def sphere(n: int = N, seed: int = 1) -> FloatArray:
    """Random points on the unit sphere."""
    points = np.random.default_rng(seed).normal(size=(n, 3))
    return np.asarray(points / np.linalg.norm(points, axis=1, keepdims=True))


def thinned(points: FloatArray, ratio: float, seed: int = 2) -> FloatArray:
    """The points, of whose upper half only one in `ratio` is left."""
    kept = (points[:, 2] < 0) | (np.random.default_rng(seed).random(len(points)) < 1 / ratio)
    return points[kept]


def test_the_median_of_local_spacings_is_the_spacing() -> None:
    neighbors = neighborhoods(sphere(), 9)
    assert np.median(local_spacings(neighbors)) == pytest.approx(spacing(neighbors))
    assert spacing(neighbors) == pytest.approx(np.sqrt(4 * np.pi / N), rel=0.1)


@pytest.mark.parametrize(("n", "ratio", "error"), [(N, 10, 0.003), (N, 30, 0.006), (80_000, 100, 0.006)])
def test_interpolated_points_are_on_the_surface_and_leave_no_gap(n: int, ratio: float, error: float) -> None:
    points = thinned(sphere(n), ratio)
    cloud = PointCloud(points, points, viewpoints=2 * points)
    some = neighborhoods(points, 9, of_some=True)
    dense = interpolated(cloud, some, cell=max(CELL, spacing(some)))
    np.testing.assert_array_equal(dense.points[: len(points)], points)
    added, normals = dense.points[len(points) :], dense.normals
    assert normals is not None and dense.viewpoints is not None
    np.testing.assert_allclose(np.linalg.norm(added, axis=1), 1, atol=error)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)
    assert np.einsum("ij,ij->i", normals[len(points) :], added).min() > 0.9
    # The sensor of each is that of a sparse point nearby.
    assert np.einsum("ij,ij->i", dense.viewpoints, dense.points).min() > 0
    # Every place of the sphere has a point as near as at the density of the dense half.
    gaps, _ = cKDTree(dense.points).query(sphere(3000, seed=9))
    assert np.quantile(gaps, 0.9) < 1.5 * CELL


def sparse_at(spacings: FloatArray, exponent: float = 0.5) -> int:
    """The number of sparse points, if the distance of neighbour k grows like k^exponent."""
    growth = np.concatenate([[0], (np.arange(1, 21) / 6) ** exponent])
    distance = np.sqrt(6 / np.pi) * spacings[:, None] * growth
    neighbors = Neighborhoods(distance, np.zeros(distance.shape, dtype=np.intp))
    return int(sparse_points(neighbors, cell=0.01, diagonal=1).sum())


def test_which_points_are_sparse() -> None:
    spacings = np.full(1000, 0.01)
    spacings[:2] = 0.04  # too few
    assert sparse_at(spacings) == 0
    spacings[:100] = 0.04
    assert sparse_at(spacings) == 100
    assert sparse_at(spacings, exponent=1 / 3) == 0  # in a volume
    spacings[:100] = 0.4  # isolated
    assert sparse_at(spacings) == 0
