"""The distance field: the compiled fit is that of NumPy, and planes and spheres are found."""

from __future__ import annotations

import numpy as np
import pytest

from pcretrieve.surface.field import (
    CURVATURE,
    LEAST_EXTENT,
    LEAST_WEIGHT,
    REACH,
    SPREAD,
    _fitted,
)
from pcretrieve.values import FloatArray

SHAPE = (14, 13, 12)


def fitted(points: FloatArray, normals: FloatArray, voxel: FloatArray) -> float:
    """The distance from one voxel, by the equations of Guennebaud et al."""
    p = points - voxel
    near = np.linalg.norm(p, axis=1) <= REACH
    p, n = p[near], normals[near]
    w = np.exp(-(p**2).sum(axis=1) / (2 * SPREAD**2))
    if w.sum() <= LEAST_WEIGHT:
        return np.nan
    share = w / w.sum()
    extent = share @ (p**2).sum(axis=1) - ((share @ p) ** 2).sum()
    turning = share @ (p * n).sum(axis=1) - (share @ p) @ (share @ n)
    q = CURVATURE / 2 * turning / extent if extent > LEAST_EXTENT else 0.0
    u = share @ n - 2 * q * share @ p
    u_0 = -share @ (p @ u + q * (p**2).sum(axis=1))
    steepness = np.linalg.norm(u)
    return float(2 * u_0 / (steepness + np.sqrt(max(steepness**2 - 4 * u_0 * q, 0))))


@pytest.mark.parametrize("n", [40, 400])
def test_the_fit_is_that_of_the_equations(n: int) -> None:
    random = np.random.default_rng(0)
    points = random.uniform(-0.5, np.array(SHAPE) - 0.5, size=(n, 3))
    normals = random.normal(size=(n, 3)) * [0.3, 0.3, 1]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    found = _fitted(points, normals, np.zeros(SHAPE, dtype=np.float32))
    expected = np.array(
        [fitted(points, normals, np.array(voxel)) for voxel in np.ndindex(SHAPE)]
    ).reshape(SHAPE)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
    assert np.isnan(found).any() == (n == 40)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5)


def test_voxels_far_from_the_points_have_no_distance() -> None:
    points = np.array([[2.0, 2.0, 2.0]])
    away = np.linalg.norm(np.moveaxis(np.indices(SHAPE), 0, -1) - 2, axis=-1).astype(
        np.float32
    )
    found = _fitted(points, np.array([[0.0, 0.0, 1.0]]), away)
    assert found[2, 2, 4] == pytest.approx(2, abs=1e-6)
    assert np.isnan(found[away > REACH]).all()
