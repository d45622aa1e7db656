"""The nearest points are those of a k-d tree, however the points are distributed."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from pcretrieve.points.neighbors import nearest
from pcretrieve.values import FloatArray

RNG = np.random.default_rng(0)
ON_SPHERE = RNG.normal(size=(4000, 3))
ON_SPHERE /= np.linalg.norm(ON_SPHERE, axis=1, keepdims=True)
CLOUDS = {
    "sphere": ON_SPHERE,
    "far from the origin": ON_SPHERE + 1e6,
    "cube": RNG.random((3000, 3)),
    "plane": np.pad(RNG.random((2000, 2)), ((0, 0), (0, 1))),
    "line": np.pad(RNG.random((500, 1)), ((0, 0), (0, 2))),
    "of very different density": RNG.normal(size=(3000, 3)) ** 5,
    "with strays": np.concatenate([ON_SPHERE, [[1e5, 0, 0], [0, -1e7, 3]]]),
}


@pytest.mark.parametrize("k", [9])
@pytest.mark.parametrize("points", CLOUDS.values(), ids=CLOUDS)
def test_the_nearest_points_are_those_of_a_tree(points: FloatArray, k: int) -> None:
    beside = points.mean(axis=0) + 1.5 * (points[::7] - points.mean(axis=0))
    for places in (points, beside):
        distance, near = nearest(points, places, k)
        expected, numbers = cKDTree(points).query(places, k=np.arange(1, k + 1))
        np.testing.assert_array_equal(distance, expected)
        np.testing.assert_array_equal(near, numbers)


def test_points_that_coincide_are_neighbours_at_distance_zero() -> None:
    points = np.repeat(CLOUDS["cube"][:100], 3, axis=0)
    distance, near = nearest(points, points, 3)
    assert (distance == 0).all()
    assert (np.sort(near, axis=1) // 3 == np.arange(300)[:, None] // 3).all()
