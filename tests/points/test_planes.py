"""Least-squares planes by closed formulas are those of LAPACK."""

import numpy as np

from pcretrieve.points.neighbors import guided_planes, plane_deviations

RNG = np.random.default_rng(0)
K = 9
POINTS = RNG.normal(size=(200, K, 3)) * [1.0, 0.7, 0.05] @ np.linalg.qr(RNG.normal(size=(3, 3)))[0] + 5
NEAR = np.arange(200 * K).reshape(200, K)


def test_deviations_are_the_smallest_singular_values() -> None:
    centred = POINTS - POINTS.mean(axis=1, keepdims=True)
    expected = np.linalg.svd(centred, compute_uv=False)[:, 2] / np.sqrt(K - 3)
    np.testing.assert_allclose(plane_deviations(POINTS.reshape(-1, 3), NEAR), expected, rtol=1e-9)


def test_normals_are_the_last_eigenvectors_with_the_orientation_of_the_guide() -> None:
    points = POINTS.reshape(-1, 3)
    near = np.repeat(NEAR, K, axis=0)  # of each point, all points of its group
    distance = np.zeros(near.shape)
    distance[:, -1] = 1.0  # no weight depends on the distance, except that of the last neighbour
    guide = np.tile([0.6, 0.0, 0.8], (len(points), 1))
    normals = guided_planes(points, guide, near, distance, 0.2, 0.7)
    weight = np.append(np.ones(K - 1), np.exp(-(0.7**-2)))
    for group, normal in zip(POINTS, normals[::K], strict=True):
        centred = group - weight @ group / weight.sum()
        axis = np.linalg.eigh(centred.T @ (weight[:, None] * centred))[1][:, 0]
        np.testing.assert_allclose(normal, axis * np.sign(axis @ guide[0]), atol=1e-10)


def test_a_neighbourhood_without_a_plane_has_a_unit_normal() -> None:
    points = np.ones((K, 3))
    near, distance = np.tile(np.arange(K), (K, 1)), np.ones((K, K))
    normals = guided_planes(points, np.zeros((K, 3)), near, distance, 0.2, 0.7)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)
