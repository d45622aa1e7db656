"""Density that varies over a body: sparse points are kept, and points are interpolated between them."""

from __future__ import annotations

import numpy as np
import pytest

from pcretrieve import PointCloud
from pcretrieve.options import ScanOptions
from pcretrieve.points.clean import clean
from pcretrieve.points.density import disks, interpolated, is_of_surface, local_spacings, sparse_points
from pcretrieve.points.neighbors import Neighborhoods, neighborhoods, spacing
from pcretrieve.points.normals import oriented_normals
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


def with_interpolated(points: FloatArray) -> PointCloud:
    cloud = PointCloud(points, points, viewpoints=2 * points)
    some = neighborhoods(points, 9, of_some=True)
    return interpolated(cloud, some, cell=max(CELL, spacing(some)))


def test_the_median_of_local_spacings_is_the_spacing() -> None:
    neighbors = neighborhoods(sphere(), 9)
    assert np.median(local_spacings(neighbors)) == pytest.approx(spacing(neighbors))
    assert spacing(neighbors) == pytest.approx(np.sqrt(4 * np.pi / N), rel=0.1)


@pytest.mark.parametrize("n", [500, 5000, N])
def test_nothing_is_interpolated_at_uniform_density(n: int) -> None:
    cloud = PointCloud(sphere(n), sphere(n))
    some = neighborhoods(cloud.points, 9, of_some=True)
    assert interpolated(cloud, some, cell=max(CELL, spacing(some))) is cloud


@pytest.mark.parametrize(("n", "ratio", "error"), [(N, 10, 0.003), (N, 30, 0.006), (80_000, 100, 0.006)])
def test_interpolated_points_are_on_the_surface(n: int, ratio: float, error: float) -> None:
    points = thinned(sphere(n), ratio)
    dense = with_interpolated(points)
    np.testing.assert_array_equal(dense.points[: len(points)], points)
    added, normals = dense.points[len(points) :], dense.normals
    assert normals is not None and dense.viewpoints is not None
    np.testing.assert_allclose(np.linalg.norm(added, axis=1), 1, atol=error)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)
    assert np.einsum("ij,ij->i", normals[len(points) :], added).min() > 0.9
    # The sensor of each is that of a sparse point nearby.
    assert np.einsum("ij,ij->i", dense.viewpoints, dense.points).min() > 0


@pytest.mark.parametrize(("n", "ratio"), [(N, 10), (N, 30), (80_000, 100)])
def test_no_gap_is_left(n: int, ratio: float) -> None:
    """Every place of the sphere has a point as near as at the density of the dense half."""
    from scipy.spatial import cKDTree

    dense = with_interpolated(thinned(sphere(n), ratio))
    gaps, _ = cKDTree(dense.points).query(sphere(3000, seed=9))
    assert np.quantile(gaps, 0.9) < 1.5 * CELL


def test_thin_parts_have_two_sides() -> None:
    """Points of the other side of a sheet, nearer than those of the same side, do not count."""
    rng = np.random.default_rng(1)
    places = rng.uniform(size=(30_000, 2))
    places = places[(places[:, 0] < 0.5) | (rng.random(len(places)) < 0.03)]
    side = np.where(rng.random(len(places)) < 0.5, 1.0, -1.0)
    points = np.column_stack([places, 0.02 * side])
    normals = np.column_stack([np.zeros((len(places), 2)), side])
    some = neighborhoods(points, 9, of_some=True)
    dense = interpolated(PointCloud(points, normals), some, cell=0.01)
    added = slice(len(points), None)
    assert dense.normals is not None
    np.testing.assert_allclose(dense.points[added, 2], 0.02 * np.sign(dense.normals[added, 2]), atol=1e-6)
    assert len(dense.points) > len(points) + 1000


def test_disks_close_the_surface_between_sparse_points() -> None:
    from scipy.spatial import cKDTree

    points = thinned(sphere(), 30)
    neighbors = neighborhoods(points, 21)
    spacings = local_spacings(neighbors)
    sparse = sparse_points(neighbors, cell=CELL, diagonal=2 * np.sqrt(3))
    assert sparse[points[:, 2] > 0.1].mean() > 0.95
    assert sparse[points[:, 2] < -0.1].mean() < 0.01
    placed, centres = disks(points, -points, spacings, sparse, step=CELL)  # the sign does not matter
    assert sparse[centres].all()
    gaps, _ = cKDTree(np.concatenate([points, placed])).query(sphere(3000, seed=9))
    assert np.quantile(gaps, 0.99) < 3 * CELL


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


# --- outliers -----------------------------------------------------------------------------------------


def test_a_sparse_surface_is_no_outlier() -> None:
    points = thinned(sphere(), 30)
    cleaned = clean(PointCloud(points), ScanOptions(voxel=0))
    upper = (points[:, 2] > 0).sum()
    assert (cleaned.points[:, 2] > 0).sum() > 0.93 * upper


@pytest.mark.parametrize("n", [50, 1000])
def test_garbage_and_isolated_points_are_outliers(n: int) -> None:
    garbage = np.random.default_rng(3).uniform(-1.3, 1.3, (n, 3))
    off = np.abs(np.linalg.norm(garbage, axis=1) - 1) > 0.1
    points = np.concatenate([sphere(), garbage[off]])
    assert not is_of_surface(neighborhoods(points, 21), cell=CELL).any()
    cleaned = clean(PointCloud(points), ScanOptions(voxel=0))
    distance = np.abs(np.linalg.norm(cleaned.points, axis=1) - 1)
    assert (distance > 0.1).sum() < 0.15 * off.sum()


# --- normals ------------------------------------------------------------------------------------------


def test_the_flood_fill_does_not_pass_between_sparse_points() -> None:
    cloud = oriented_normals(PointCloud(thinned(sphere(), 20)), ScanOptions())
    assert cloud.normals is not None
    assert np.einsum("ij,ij->i", cloud.normals, cloud.points).min() > 0
    assert cloud.provenance[-1].notes == ()  # no flood fill leaked
