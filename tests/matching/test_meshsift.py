"""meshSIFT: the scale space of a surface, and features that match those of the same surface elsewhere."""

from __future__ import annotations

import logging

import numpy as np
import pytest
import shapes

from pcretrieve.errors import DegenerateMeshError
from pcretrieve.matching import MATCHERS, meshsift as module
from pcretrieve.matching.meshsift import keypoints, levels, match_distance, mesh_features
from pcretrieve.values import TriangleMesh

BALL = shapes.icosphere(4)
MATCH = MATCHERS["meshsift"]


def bumpy(seed: int) -> TriangleMesh:
    """A ball with sixty bumps and pits at random places."""
    rng = np.random.default_rng(seed)
    centres = rng.normal(size=(60, 3))
    centres /= np.linalg.norm(centres, axis=1, keepdims=True)
    angles = np.arccos(np.clip(BALL.vertices @ centres.T, -1, 1))
    radius = 1 + np.exp(-((angles / 0.13) ** 2) / 2) @ rng.uniform(-0.08, 0.12, 60)
    return TriangleMesh(BALL.vertices * radius[:, np.newaxis], BALL.faces)


BUMPY = bumpy(0)


# --- scale space ----------------------------------------------------------------------------------------


def test_curvatures_of_a_ball_and_of_a_ring() -> None:
    ball = levels(shapes.icosphere(4, radius=2.0))[0]
    # Smoothing moves the twelve vertices with five neighbours more than the others.
    np.testing.assert_allclose(np.median(ball.curvatures, axis=0), 0.5, rtol=0.02)
    ring = shapes.torus(96, 48)
    made = levels(ring)[0].curvatures
    np.testing.assert_allclose(made[:, 0], 1 / 0.4, rtol=0.05)  # around the tube
    outside = np.linalg.norm(ring.vertices[:, :2], axis=1) > 1.39
    np.testing.assert_allclose(made[outside, 1], 1 / 1.4, rtol=0.05)


def test_a_bump_on_a_ball_is_the_only_keypoint() -> None:
    angles = np.arccos(np.clip(BALL.vertices @ BALL.vertices[200], -1, 1))
    bump = 1 + 0.1 * np.exp(-((angles / 0.12) ** 2) / 2)
    mesh = TriangleMesh(BALL.vertices * bump[:, np.newaxis], BALL.faces)
    (vertex,), _ = keypoints(levels(mesh), mesh, 99)
    assert angles[vertex] < 0.1
    assert not len(keypoints(levels(BALL), BALL, 99)[0])


# --- features -------------------------------------------------------------------------------------------


def test_moved_scaled_and_renumbered_surfaces_match() -> None:
    made = MATCH.prepare(shapes.shape(BUMPY))
    np.testing.assert_array_equal(made, MATCH.prepare(shapes.shape(BUMPY)))
    assert MATCH.distance(made, made) < 0.1
    moved = MATCH.prepare(shapes.shape(shapes.renumbered(shapes.moved(BUMPY, 1, scale=7), 2)))
    assert MATCH.distance(made, moved) < 0.1
    noise = np.random.default_rng(0).normal(scale=0.002, size=BUMPY.vertices.shape)
    noisy = MATCH.prepare(shapes.shape(TriangleMesh(BUMPY.vertices + noise, BUMPY.faces)))
    other = MATCH.prepare(shapes.shape(bumpy(1)))
    assert MATCH.distance(made, noisy) < 0.3 < 0.7 < MATCH.distance(made, other)


def test_a_match_is_clearly_nearer_than_the_second() -> None:
    one, two = (
        np.column_stack([np.cos(angles), np.sin(angles)]).astype(np.float32)
        for angles in (np.array([0.0, 0.5, 2.0]), np.array([0.1, 0.6, 1.25]))
    )
    # From one: .1 of .6, .1 of .4, .75 of 1.4. From two: .1 of .4, .1 of .6; the nearest of the third, .65 of
    # .75, is not mutual, nor clear.
    assert match_distance(one, two) == pytest.approx(1 - (2 + 2) / 2 / 3)
    assert match_distance(two, one) == match_distance(one, two)
    assert match_distance(one, two[:2]) == pytest.approx(1 - 2 / 3), "by the larger number of features"
    assert match_distance(one, two[:1]) == pytest.approx(1 - 1 / 2 / 3)


def test_coarse_surfaces_are_warned_of_once(caplog: pytest.LogCaptureFixture) -> None:
    module._warn_once.cache_clear()
    with caplog.at_level(logging.WARNING, logger="pcretrieve"):
        mesh_features(shapes.shape(BUMPY))
        assert not caplog.records
        for _ in range(2):
            mesh_features(shapes.shape(shapes.body(3)))
    (record,) = caplog.records
    assert "meshsift needs surfaces of at least 5000 faces" in record.getMessage()


def test_surfaces_without_features_are_named() -> None:
    point = TriangleMesh(np.zeros((4, 3)), shapes.TETRAHEDRON_FACES)
    for mesh, message in ((point, "no face of 4 has an area"), (shapes.tetrahedron(), "no keypoints")):
        with pytest.raises(DegenerateMeshError, match=message):
            mesh_features(shapes.shape(mesh))
