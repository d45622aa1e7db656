"""Smoothing removes noise from the vertices that may move, and does not change others."""

from __future__ import annotations

import numpy as np
import pytest
import shapes

from pcretrieve.surface.marching import smoothed
from pcretrieve.values import FloatArray, TriangleMesh

BALL = shapes.icosphere(4)
EVERYWHERE = np.arange(len(BALL.vertices))


def rough(noise: float = 0.01) -> FloatArray:
    """The ball's vertices, moved along its normals."""
    rng = np.random.default_rng(0)
    vertices: FloatArray = BALL.vertices * (1 + noise * rng.standard_normal((len(BALL.vertices), 1)))
    return vertices


def roughness(vertices: FloatArray) -> float:
    return float(np.linalg.norm(vertices, axis=1).std())


def test_only_what_may_move_moves() -> None:
    vertices = rough()
    above = np.flatnonzero(vertices[:, 2] > 0)
    moved = smoothed(vertices, BALL.faces, above, 8)
    changed = np.flatnonzero((moved != vertices).any(axis=1))
    np.testing.assert_array_equal(changed, above)


def test_what_may_not_move_holds_the_rest() -> None:
    """A single vertex among fixed ones moves near the mean of its neighbours."""
    vertices = BALL.vertices.copy()
    vertices[0] *= 2
    moved = smoothed(vertices, BALL.faces, np.array([0]), 8)
    assert 1 < np.linalg.norm(moved[0]) < 1.15


def test_noise_goes_and_the_volume_stays() -> None:
    vertices = rough()
    moved = smoothed(vertices, BALL.faces, EVERYWHERE, 8)
    assert roughness(moved) < 0.45 * roughness(vertices)
    assert TriangleMesh(moved, BALL.faces).volume == pytest.approx(BALL.volume, rel=0.002)
