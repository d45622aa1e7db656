"""Voxels: components, distances, and the outside of points."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import shapes
from scipy import ndimage

from pcretrieve.points.voxels import (
    CLEARANCE,
    _regrown,
    components,
    distances,
    flood,
    sampled,
)
from pcretrieve.values import FloatArray, Grid


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_components_are_those_of_scipy_with_the_same_numbers(share: float) -> None:
    for shape in ((1, 9, 30), (20, 31, 40)):
        voxels = np.random.default_rng(0).random(shape) < share
        for corners in (False, True):
            labels, sizes = components(voxels, corners)
            expected, n = ndimage.label(voxels, np.ones((3, 3, 3)) if corners else None)
            np.testing.assert_array_equal(labels, expected)
            np.testing.assert_array_equal(
                sizes, np.bincount(expected.ravel(), minlength=n + 1)
            )


@pytest.mark.parametrize("limit", [3.5, np.inf])
def test_distances_are_exact_up_to_the_limit(limit: float) -> None:
    for shape in ((1, 9, 20), (23, 31, 17)):
        for share in (0.002, 0.1):
            sources = np.random.default_rng(0).random(shape) < share
            sources[0, 0, 0] = True
            expected = np.minimum(ndimage.distance_transform_edt(~sources), limit).astype(
                np.float32
            )
            np.testing.assert_array_equal(distances(sources, limit), expected)
    assert (
        distances(np.zeros((3, 4, 5), dtype=bool), limit) == limit
    ).all()  # without sources


# --- the outside of points ----------------------------------------------------------------------------

EDGE, GAP = 0.06, 0.2


def radii(grid: Grid) -> FloatArray:
    at = np.moveaxis(np.indices(grid.shape), 0, -1)
    return np.asarray(np.linalg.norm(grid.centres(at), axis=-1))


def shell(hole: float) -> FloatArray:
    """Points on the unit ball without a cap, whose rim is a circle of radius `hole`."""
    points = shapes.points_on(shapes.icosphere(4), 20_000)
    return np.asarray(points[points[:, 2] < np.sqrt(1 - hole**2)])


def test_the_flood_passes_holes_wider_than_the_gap_only() -> None:
    middle = np.random.default_rng(0).uniform(-0.5, 0.5, (1000, 3))
    for hole in (0.0, 0.6 * GAP):
        outside = flood(shell(hole), cell=EDGE, gap=GAP)
        assert not outside.reached[outside.grid.index(middle)].any()
        # The space near the points is narrower than the walls, and is reached in the second pass.
        assert outside.reached[radii(outside.grid) > 1 + 3 * EDGE].all()
        assert not outside.reached[outside.distance <= 1.5].any()
    outside = flood(shell(1.6 * GAP), cell=EDGE, gap=GAP)
    assert outside.reached[outside.grid.index(np.zeros((1, 3)))].all()


def test_values_between_voxels_are_those_of_scipy() -> None:
    random = np.random.default_rng(0)
    values = random.normal(size=(4, 5, 6)).astype(np.float32)
    at = random.uniform(-2, 8, size=(200, 3))
    expected = ndimage.map_coordinates(
        values.astype(float), at.T, order=1, mode="nearest"
    )
    np.testing.assert_allclose(sampled(values, at), expected, atol=1e-6)


def test_the_second_pass_is_a_dilation_within_a_mask() -> None:
    points = np.zeros((26, 28, 30), dtype=bool)
    points[6:-6, 6:-6, 6:-6] = np.random.default_rng(0).random((14, 16, 18)) < 0.01
    to_points = distances(points, 9.0)
    outside = to_points > 3
    expected = ndimage.binary_dilation(outside, iterations=4, mask=to_points > CLEARANCE)
    found = _regrown(outside, to_points, 3.0)
    assert outside.sum() < found.sum()
    np.testing.assert_array_equal(found, expected)


def test_depth_grows_and_direction_points_to_the_outside() -> None:
    outside = flood(shell(0.0), cell=EDGE, gap=GAP)
    rays = np.random.default_rng(1).standard_normal((500, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    depths = [outside.depth_at(reach * rays) for reach in (1.3, 1.0, 0.9, 0.7)]
    assert (depths[0] == 0).all()
    assert all((deeper > shallower).all() for shallower, deeper in pairwise(depths))
    # The depth is the distance to the outside, in voxels.
    assert depths[3] - depths[1] == pytest.approx(0.3 / EDGE, abs=1)
    for reach in (1.0, 0.8):
        towards = outside.direction_at(reach * rays)
        np.testing.assert_allclose(np.linalg.norm(towards, axis=1), 1)
        assert np.einsum("ij,ij->i", towards, rays).min() > 0.7
    assert (outside.direction_at(1.3 * rays) == 0).all()
