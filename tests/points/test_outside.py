"""The flood fill reaches the outside of a body, and nothing else."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import shapes

from pcretrieve.points.outside import flood
from pcretrieve.values import FloatArray

RADIUS = 1.0
CELL = 0.06
GAP = 0.2


def shell(hole: float, n: int = 20_000) -> FloatArray:
    """Points on a ball without a cap, whose rim is a circle of radius `hole`."""
    points = shapes.points_on(shapes.icosphere(4, RADIUS), n)
    seen: FloatArray = points[points[:, 2] < np.sqrt(RADIUS**2 - hole**2)]
    return seen


@pytest.mark.parametrize("hole", [0.0, 0.6 * GAP])
def test_the_flood_does_not_pass_a_hole_narrower_than_the_gap(hole: float) -> None:
    outside = flood(shell(hole), cell=CELL, gap=GAP)
    reached = outside.reached[outside.grid.index(np.random.default_rng(0).uniform(-0.5, 0.5, (1000, 3)))]
    assert not reached.any()


def test_the_outside_reaches_the_clearance_around_the_points() -> None:
    """The space is narrower than the walls, and is reached in the second pass."""
    outside = flood(shell(0.0), cell=CELL, gap=GAP)
    distance = np.linalg.norm(
        np.moveaxis(np.indices(outside.grid.shape), 0, -1) * CELL + outside.grid.origin, axis=-1
    )
    assert outside.reached[distance > RADIUS + 3 * CELL].all()
    assert not outside.reached[outside.distance <= 1.5].any()


def test_depth_grows_and_direction_points_to_the_outside() -> None:
    outside = flood(shell(0.0), cell=CELL, gap=GAP)
    rays = np.random.default_rng(1).standard_normal((500, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    depths = [outside.depth_at(reach * rays) for reach in (1.3, 1.0, 0.9, 0.7)]
    assert (depths[0] == 0).all()
    assert all((deeper > shallower).all() for shallower, deeper in pairwise(depths))
    # The depth is the distance to the outside, in voxels.
    assert depths[3] - depths[1] == pytest.approx(0.3 / CELL, abs=1)
    for reach in (1.0, 0.8):
        towards = outside.direction_at(reach * rays)
        np.testing.assert_allclose(np.linalg.norm(towards, axis=1), 1)
        assert np.einsum("ij,ij->i", towards, rays).min() > 0.7
    assert (outside.direction_at(1.3 * rays) == 0).all()


def test_a_hole_wider_than_the_gap_leaks() -> None:
    outside = flood(shell(1.6 * GAP), cell=CELL, gap=GAP)
    assert outside.reached[outside.grid.index(np.zeros((1, 3)))].all()
