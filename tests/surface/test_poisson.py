"""Points interpolated between sparse ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapes
from scipy.spatial import cKDTree

from pcretrieve.formats import read_scan
from pcretrieve.options import PipelineOptions
from pcretrieve.pipeline.process import process
from pcretrieve.points.neighbors import neighborhoods, spacing
from pcretrieve.surface.poisson import interpolated
from pcretrieve.values import PointCloud

SCANS = Path(__file__).parents[2] / "scans"


@pytest.mark.parametrize(
    ("n", "ratio", "error"),
    [(20_000, 10, 0.003), (20_000, 30, 0.006), (80_000, 100, 0.006)],
)
def test_interpolated_points_are_on_the_surface_and_leave_no_gap(
    n: int, ratio: float, error: float
) -> None:
    """On a sphere of whose upper half one point in `ratio` is left; 20,000 points are .025 apart."""
    points, cell = shapes.on_sphere(n), 0.02
    points = points[(points[:, 2] < 0) | (np.random.default_rng(2).random(n) < 1 / ratio)]
    some = neighborhoods(points, 9, of_some=True)
    dense = interpolated(
        PointCloud(points, points, viewpoints=2 * points),
        some,
        cell=max(cell, spacing(some)),
    )
    np.testing.assert_array_equal(dense.points[: len(points)], points)
    added, normals = dense.points[len(points) :], dense.normals
    assert normals is not None and dense.viewpoints is not None
    np.testing.assert_allclose(np.linalg.norm(added, axis=1), 1, atol=error)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)
    assert np.einsum("ij,ij->i", normals[len(points) :], added).min() > 0.9
    # The sensor of each is that of a sparse point nearby.
    assert np.einsum("ij,ij->i", dense.viewpoints, dense.points).min() > 0
    # Every place of the sphere has a point as near as at the density of the dense half.
    gaps, _ = cKDTree(dense.points).query(shapes.on_sphere(3000, seed=9))
    assert np.quantile(gaps, 0.9) < 1.5 * cell


def test_hands_do_not_explode_where_points_are_sparse() -> None:
    """Of the right half of a scan, one point in ten is left: there, points are as far apart as fingers."""
    scan = read_scan(SCANS / "person-1" / "person-1_stand.ply")
    assert isinstance(scan, PointCloud)
    is_left = np.random.default_rng(0).random(len(scan.points)) < 0.1
    is_left |= scan.points[:, 0] < np.median(scan.points[:, 0])
    whole, thin = (
        process(cloud, PipelineOptions()).mesh for cloud in (scan, scan.select(is_left))
    )
    apart, _ = cKDTree(whole.vertices).query(thin.vertices)
    assert np.quantile(apart, 0.99) < 0.015 * scan.diagonal
    assert thin.area < 1.1 * whole.area
