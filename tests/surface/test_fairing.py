"""Holes of bodies whose surface is known are closed by what was there."""

from __future__ import annotations

import numpy as np
import pytest
import shapes
from numpy.typing import NDArray

from pcretrieve.arrays import vertex_normals
from pcretrieve.surface.fairing import domed, faired, membrane, with_ring
from pcretrieve.values import TriangleMesh

BALL = shapes.ellipsoid((1, 1, 1), subdivisions=4)


def flattened(
    mesh: TriangleMesh, angle: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """The vertices of a ball with a flat cap round the north pole, and those of the cap."""
    height = np.cos(np.radians(angle))
    cap = mesh.vertices[:, 2] > height
    vertices = mesh.vertices.copy()
    vertices[cap, 2] = height
    return vertices, cap


@pytest.mark.parametrize(
    ("angle", "error"), [(30, 0.002), (45, 0.002), (60, 0.01), (75, 0.06)]
)
def test_the_flat_cap_of_a_sphere_becomes_the_sphere(angle: float, error: float) -> None:
    vertices, cap = flattened(BALL, angle)
    closed = faired(vertices, BALL.faces, cap)
    np.testing.assert_array_equal(closed[~cap], vertices[~cap])
    assert np.abs(np.linalg.norm(closed[cap], axis=1) - 1).max() < error


@pytest.mark.parametrize(("angle", "error"), [(60, 0.03), (90, 0.02), (110, 0.06)])
def test_a_deep_hole_of_a_sphere_becomes_the_sphere(angle: float, error: float) -> None:
    """Fairing makes no more than half of a sphere of a flat patch."""
    cap = BALL.vertices[:, 2] > np.cos(np.radians(angle))
    flat = membrane(BALL.vertices, BALL.faces, cap)
    assert np.ptp(flat[cap, 2]) < 0.05
    closed = domed(flat, BALL.faces, cap, np.array([0.0, 0.0, 1.0]), np.radians(angle))
    np.testing.assert_array_equal(closed[~cap], BALL.vertices[~cap])
    assert np.abs(np.linalg.norm(closed[cap], axis=1) - 1).max() < error


def test_a_long_head_that_is_cut_below_its_widest_place_becomes_as_high_as_long() -> None:
    head = shapes.ellipsoid((1, 0.7, 1), subdivisions=4)
    angle = np.radians(105)
    cap = head.vertices[:, 2] > np.cos(angle)
    flat = membrane(head.vertices, head.faces, cap)
    closed = domed(flat, head.faces, cap, np.array([0.0, 0.0, 1.0]), angle)
    assert closed[:, 2].max() == pytest.approx(1, abs=0.05)


def test_a_part_without_a_rim_stays_in_its_place() -> None:
    """As one that no point supports: nothing else holds it, so that its equations are singular."""
    vertices, cap = flattened(BALL, 45)
    both = np.concatenate([vertices, 0.1 * BALL.vertices + 3])
    faces = np.concatenate([BALL.faces, BALL.faces + len(vertices)])
    free = np.concatenate([cap, np.ones(len(vertices), dtype=bool)])
    closed = faired(both, faces, free)
    ball, apart = closed[: len(vertices)], closed[len(vertices) :]
    assert np.abs(np.linalg.norm(ball, axis=1) - 1).max() < 0.06
    np.testing.assert_allclose(apart.mean(axis=0), 3, atol=0.05)
    assert np.ptp(apart, axis=0).max() < 1


def test_a_fair_patch_does_not_depend_on_the_unit() -> None:
    vertices, cap = flattened(BALL, 45)
    closed = faired(vertices, BALL.faces, cap)
    np.testing.assert_allclose(
        faired(1000 * vertices, BALL.faces, cap), 1000 * closed, atol=1e-4
    )


def test_noise_of_the_rim_does_not_raise_a_patch() -> None:
    vertices, cap = flattened(BALL, 45)
    noise = np.random.default_rng(0).normal(0, 0.004, vertices.shape)
    closed = faired(vertices + noise * ~cap[:, np.newaxis], BALL.faces, cap)
    assert np.abs(np.linalg.norm(closed[cap], axis=1) - 1).max() < 0.03


def test_a_hole_beside_a_hollow_is_closed_by_the_least_bending() -> None:
    """A rim that is concave does not pull the patch inwards."""
    vertices, cap = flattened(BALL, 30)
    inside_out = BALL.faces[:, ::-1].copy()
    closed = faired(vertices, inside_out, cap)
    assert 0.97 < closed[:, 2].max() < 1.0


def test_rings_and_normals_of_a_ball() -> None:
    pole = np.zeros(len(BALL.vertices), dtype=np.bool_)
    pole[0] = True
    ring = with_ring(pole, BALL.faces)
    assert ring.sum() in (6, 7)
    normals = vertex_normals(BALL.vertices, BALL.faces)
    np.testing.assert_allclose(normals, BALL.vertices, atol=0.01)


def test_fairing_keeps_the_last_sound_round() -> None:
    """On a disk with a noisy rim each round draws vertices together, until faces have hardly any area."""
    disk = shapes.ellipsoid((1, 1, 0.15), subdivisions=4)
    upper = disk.vertices[:, 2] > 0
    noise = np.random.default_rng(1).normal(0, 0.003, disk.vertices.shape)
    vertices = disk.vertices + noise * ~upper[:, np.newaxis]
    vertices[upper, 2] = 0
    closed = faired(vertices, disk.faces, upper)
    areas = TriangleMesh(closed, disk.faces[upper[disk.faces].any(axis=1)]).face_areas
    assert areas.min() > 1e-4 * areas.mean()
