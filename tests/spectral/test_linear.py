"""Linear finite elements: hand-worked matrices, and the eigenvalues they converge to."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import shapes

from pcretrieve.spectral import eigenpairs, laplace_beltrami
from pcretrieve.values import TriangleMesh

masses = pytest.mark.parametrize("mass", ["consistent", "lumped"])


def test_stiffness_of_one_triangle_is_half_its_cotangents() -> None:
    triangle = TriangleMesh(
        np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]], dtype=np.int32)
    )
    operator = laplace_beltrami(triangle)
    # Angles 90°, 45° and 45°: cotangents 0, 1 and 1.
    np.testing.assert_allclose(
        operator.stiffness.toarray(), [[1, -0.5, -0.5], [-0.5, 0.5, 0], [-0.5, 0, 0.5]]
    )
    np.testing.assert_allclose(operator.mass.toarray(), np.array([[2, 1, 1], [1, 2, 1], [1, 1, 2]]) / 24)


# --- what they converge to ----------------------------------------------------------------------------


def sphere_eigenvalues(n_pairs: int) -> list[int]:
    """l (l + 1), 2 l + 1 times each."""
    return [degree * (degree + 1) for degree in range(n_pairs) for _ in range(2 * degree + 1)][:n_pairs]


@masses
def test_eigenvalues_of_the_sphere_converge_at_order_two(mass: Any) -> None:
    exact = np.array(sphere_eigenvalues(36), dtype=float)
    errors = [
        np.abs(eigenpairs(laplace_beltrami(shapes.icosphere(level), mass=mass), 36).eigenvalues - exact)[1:]
        / exact[1:]
        for level in (3, 4, 5)
    ]
    # An edge halves from level to level, so errors of order two fall to a quarter; some fall faster, where
    # the symmetries of the mesh are those of the eigenfunction.
    assert np.log2(np.array(errors[:-1]) / errors[1:]).min() > 1.9
    worst = np.max(errors, axis=1)
    np.testing.assert_allclose(np.log2(worst[:-1] / worst[1:]), 2, atol=0.1)
    assert worst[-1] < 0.004


def test_eigenvalues_of_a_square_with_free_boundary() -> None:
    exact = np.sort([np.pi**2 * (m**2 + n**2) for m in range(10) for n in range(10)])[:16]
    errors = [
        np.abs(eigenpairs(laplace_beltrami(shapes.square(n)), 16).eigenvalues - exact)[1:] / exact[1:]
        for n in (16, 32)
    ]
    assert errors[1].max() < 0.02
    rates = np.log2(errors[0] / errors[1])
    assert rates.min() > 1.9
    assert rates.max() < 2.1


def test_eigenvalues_are_invariant_to_bending_without_stretching() -> None:
    # A strip of paper, flat and rolled to a quarter of a tube: every edge along or across keeps its length
    # up to second order.
    flat = shapes.square(24)
    x, y, _ = flat.vertices.T
    rolled = TriangleMesh(np.column_stack([np.sin(x), y, 1 - np.cos(x)]), flat.faces)
    one, other = (eigenpairs(laplace_beltrami(mesh), 12).eigenvalues for mesh in (flat, rolled))
    np.testing.assert_allclose(one[1:], other[1:], rtol=1e-3)
