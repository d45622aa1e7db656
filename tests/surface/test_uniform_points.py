"""Random points on a surface."""

import numpy as np
import pytest

from pcretrieve.surface.reconstruct import uniform_points
from pcretrieve.values import TriangleMesh

# Two triangles in the plane z = 2, of areas 3 and 1.
TRIANGLES = TriangleMesh(
    np.array([[0.0, 0, 2], [3, 0, 2], [0, 2, 2], [10, 0, 2], [11, 0, 2], [10, 2, 2]]),
    np.array([[0, 1, 2], [3, 4, 5]]),
)


def test_density_is_that_of_the_area() -> None:
    points, faces = uniform_points(TRIANGLES, 40_000, np.random.default_rng(0))
    second = points[:, 0] >= 10
    np.testing.assert_array_equal(faces, second)
    assert second.mean() == pytest.approx(1 / 4, abs=0.01)
    # The mean of uniform points is the centroid of the triangle.
    np.testing.assert_allclose(points[~second].mean(axis=0), [1, 2 / 3, 2], atol=0.02)
    np.testing.assert_allclose(points[second].mean(axis=0), [10 + 1 / 3, 2 / 3, 2], atol=0.02)
    x, y = points[~second].T[:2]
    assert (x / 3 + y / 2).max() <= 1 + 1e-12
    # Halving the sides about a corner leaves a quarter of the area.
    assert (x / 3 + y / 2 <= 1 / 2).mean() == pytest.approx(1 / 4, abs=0.01)
