"""Rays meet a surface where they should, in any unit and at any place; threads get one library."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
import shapes

from pcretrieve.arrays.open3d import RayScene

BALL = shapes.icosphere(3)
# A unit that is a power of two changes no digit, however far single precision is from bearing it.
UNITS = [2.0**-150, 2.0**-40, 2.0**10, 2.0**70, 2.0**150]


def test_rays_meet_the_same_in_any_unit() -> None:
    rng = np.random.default_rng(0)
    origins, directions = 2 * rng.normal(size=(500, 3)), rng.normal(size=(500, 3))
    here = RayScene(BALL.vertices, BALL.faces)
    expected = here.cast(origins, directions)
    for unit in UNITS:
        there = RayScene(unit * BALL.vertices, BALL.faces)
        for found, known in zip(
            there.cast(unit * origins, unit * directions), expected, strict=True
        ):
            np.testing.assert_array_equal(found, known)
        unscaled = there.cast(unit * origins, directions)[0]
        np.testing.assert_array_equal(unscaled / unit, expected[0])
        np.testing.assert_array_equal(
            there.distance(unit * origins) / unit, here.distance(origins)
        )


def test_rays_meet_the_sphere_where_they_should_even_far_from_the_origin() -> None:
    """In single precision, its vertices would be 64 or more apart there, or coincide."""
    origins = np.array([[3.0, 0.1, 0.2], [3.0, 0.0, 0.0], [0.0, 0.0, 5.0]])
    directions = np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -2.0]])
    for place in (
        np.zeros(3),
        np.array([2.0**20, -(2.0**24), 0]),
        np.array([0, 3e8, 1e9]),
    ):
        scene = RayScene(BALL.vertices + place, BALL.faces)
        distance, normals, face = scene.cast(origins + place, directions)
        # The last in lengths of the direction.
        np.testing.assert_allclose(
            distance, [3 - np.sqrt(1 - 0.05), np.inf, 2.0], atol=0.01
        )
        assert face[1] == -1
        for ray in (0, 2):
            corners = BALL.vertices[BALL.faces[face[ray]]]
            hit = origins[ray] + distance[ray] * directions[ray]
            assert np.linalg.det(corners - hit) == pytest.approx(
                0, abs=1e-6
            )  # in the plane of that face
            assert normals[ray] @ hit > 0.9  # outwards, as its faces are
        assert scene.distance(place[None]) == pytest.approx(1, abs=0.02)


THREADS = """
import sys
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

from pcretrieve.arrays.open3d import library

sys.setswitchinterval(1e-6)
barrier = Barrier(8)

def asked(_):
    barrier.wait()
    return library()

with ThreadPoolExecutor(8) as threads:
    assert len({id(found) for found in threads.map(asked, range(8))}) == 1
"""


def test_threads_that_ask_at_once_get_one_library() -> None:
    done = subprocess.run([sys.executable, "-c", THREADS], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
