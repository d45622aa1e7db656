"""Marching cubes: a closed manifold with the topology of the voxels, for every set of voxels; smoothing."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import shapes
from numpy.typing import NDArray

from pcretrieve.surface import defects
from pcretrieve.surface.marching import Crossings, crossed, marched, smoothed
from pcretrieve.surface.topology import SOUND
from pcretrieve.values import FloatArray, TriangleMesh

Mask = NDArray[np.bool_]


def surface(body: Mask, crossings: FloatArray) -> TriangleMesh:
    """With (3, a, b, c) crossings on the links."""
    return TriangleMesh(
        *marched(body, [Crossings(at, crossings[axis][tuple(at.T)]) for axis, at in enumerate(crossed(body))])
    )


def digital_euler(body: Mask) -> int:
    """Euler number of a 6-connected set: voxels − pairs + squares of four − cubes of eight."""
    total = 0
    for along in np.ndindex(2, 2, 2):
        cells = body
        for axis in np.flatnonzero(along):
            cells = np.logical_and(*(np.delete(cells, end, axis=axis) for end in (0, -1)))
        total += (-1) ** sum(along) * int(cells.sum())
    return total


def ball(radius: float, n: int) -> tuple[Mask, FloatArray]:
    """The voxels of a ball centred at n / 2 − 0.3 on each axis, and the crossings of its sphere."""
    at = np.moveaxis(np.indices((n, n, n)), 0, -1) - (n / 2 - 0.3)
    level = (at**2).sum(axis=-1) - radius**2
    crossings = np.full((3, n, n, n), 0.5)
    for axis in range(3):
        # The root in [0, 1] of |x + t e|² = r².
        here = at[..., axis]
        root = np.sqrt(np.maximum(here**2 - level, 0))
        crossings[axis] = np.where(level < 0, -here + root, -here - root)
    return level < 0, crossings


@pytest.mark.parametrize("share", [0.15, 0.5, 0.85])
def test_any_set_of_cells_has_a_closed_manifold_surface_that_crosses_where_it_must(share: float) -> None:
    """All 256 cubes are in random cells, beside any other."""
    rng = np.random.default_rng(0)
    body = np.pad(rng.random((14, 14, 14)) < share, 1)
    crossings = rng.uniform(0.02, 0.98, (3, *body.shape))
    mesh = surface(body, crossings)
    assert replace(defects(mesh), components=1) == SOUND
    assert mesh.euler_characteristic == 2 * digital_euler(body)
    n = 0
    for axis, at in enumerate(crossed(body)):
        expected = at + crossings[axis][tuple(at.T)][:, None] * np.eye(3)[axis]
        np.testing.assert_array_equal(mesh.vertices[n : n + len(at)], expected)
        n += len(at)
    assert mesh.volume > 0


def test_a_ball_converges_with_the_square_of_the_cell() -> None:
    errors = []
    for radius in (5.0, 10.0, 20.0):
        body, crossings = ball(radius, int(2 * radius) + 6)
        mesh = surface(body, crossings)
        assert not defects(mesh)
        errors.append(1 - mesh.volume / (4 / 3 * np.pi * radius**3))
    assert errors[-1] == pytest.approx(0, abs=2e-3)
    assert all(3 < coarse / fine < 5 for coarse, fine in pairwise(errors))


# --- smoothing ----------------------------------------------------------------------------------------

BALL = shapes.icosphere(4)
ROUGH: FloatArray = BALL.vertices * (
    1 + 0.01 * np.random.default_rng(0).standard_normal((len(BALL.vertices), 1))
)


def test_noise_goes_the_volume_stays_and_only_what_may_move_moves() -> None:
    moved = smoothed(ROUGH, BALL.faces, np.arange(len(ROUGH)), 8)
    assert np.linalg.norm(moved, axis=1).std() < 0.45 * np.linalg.norm(ROUGH, axis=1).std()
    assert TriangleMesh(moved, BALL.faces).volume == pytest.approx(BALL.volume, rel=0.002)
    above = np.flatnonzero(ROUGH[:, 2] > 0)
    changed = (smoothed(ROUGH, BALL.faces, above, 8) != ROUGH).any(axis=1)
    np.testing.assert_array_equal(np.flatnonzero(changed), above)
    # Near the mean of its neighbours.
    vertices = BALL.vertices.copy()
    vertices[0] *= 2
    moved = smoothed(vertices, BALL.faces, np.array([0]), 8)
    assert 1 < np.linalg.norm(moved[0]) < 1.15
