"""Eigenpairs: orthonormal, ordered, the same to the bit, by either route; and what has none."""

from __future__ import annotations

import numpy as np
import pytest
import shapes
from scipy.sparse import block_diag, csc_array

from pcretrieve.errors import OptionError, SpectrumError
from pcretrieve.spectral import eigen, eigenpairs, laplace_beltrami
from pcretrieve.types import LaplaceBeltrami, TriangleMesh

BODY = laplace_beltrami(shapes.body(3))


@pytest.fixture(params=[12, 61, 250], ids=lambda n: f"{n} pairs")  # the last of them by the dense route
def n_pairs(request: pytest.FixtureRequest) -> int:
    n: int = request.param
    return n


def is_dense(operator: LaplaceBeltrami, n_pairs: int) -> bool:
    return operator.mass.shape[0] < eigen.DENSE_UNKNOWNS_PER_PAIR * n_pairs


def test_both_routes_are_tested_here() -> None:
    assert [is_dense(BODY, n) for n in (12, 61, 250)] == [False, False, True]


# --- what they are ------------------------------------------------------------------------------------


def test_orthonormal_ascending_and_from_zero(n_pairs: int) -> None:
    pairs = eigenpairs(BODY, n_pairs)
    phi = pairs.eigenvectors
    assert phi.shape == (BODY.mass.shape[0], n_pairs)
    np.testing.assert_allclose(phi.T @ (BODY.mass @ phi), np.eye(n_pairs), atol=1e-9)
    assert pairs.eigenvalues[0] == 0
    assert (np.diff(pairs.eigenvalues) > 0).all()  # nothing about the body is symmetric
    assert (phi[:, 0] == 1 / np.sqrt(pairs.area)).all()


def test_each_solves_its_equation(n_pairs: int) -> None:
    pairs = eigenpairs(BODY, n_pairs)
    mapped = BODY.mass @ pairs.eigenvectors[:, 1:]
    residual = BODY.stiffness @ pairs.eigenvectors[:, 1:] - pairs.eigenvalues[1:] * mapped
    relative = np.linalg.norm(residual, axis=0) / (pairs.eigenvalues[1:] * np.linalg.norm(mapped, axis=0))
    assert relative.max() == pytest.approx(pairs.largest_residual, rel=0.5)
    assert relative.max() < 1e-9


def test_the_sign_is_that_of_the_largest_entry(n_pairs: int) -> None:
    phi = eigenpairs(BODY, n_pairs).eigenvectors
    assert (phi.max(axis=0) >= -phi.min(axis=0)).all()


def test_the_same_bits_each_time(n_pairs: int) -> None:
    one, two = eigenpairs(BODY, n_pairs), eigenpairs(laplace_beltrami(shapes.body(3)), n_pairs)
    assert (one.eigenvalues == two.eigenvalues).all()
    assert (one.eigenvectors == two.eigenvectors).all()


def test_both_routes_agree() -> None:
    sparse, dense = eigenpairs(BODY, 61), eigenpairs(BODY, 250)
    np.testing.assert_allclose(sparse.eigenvalues[1:], dense.eigenvalues[1:61], rtol=1e-10)
    np.testing.assert_allclose(sparse.eigenvectors, dense.eigenvectors[:, :61], atol=1e-6)


def test_fewer_pairs_are_the_first_of_more() -> None:
    np.testing.assert_allclose(
        eigenpairs(BODY, 12).eigenvalues, eigenpairs(BODY, 61).eigenvalues[:12], rtol=1e-10
    )


def test_all_of_a_symmetric_surface_are_found() -> None:
    # Clusters of equal eigenvalues tempt Lanczos to find one of each.
    sphere = laplace_beltrami(shapes.icosphere(3))
    assert not is_dense(sphere, 100)
    sparse = eigenpairs(sphere, 100).eigenvalues
    dense = np.linalg.eigvals(np.linalg.solve(sphere.mass.toarray(), sphere.stiffness.toarray())).real
    np.testing.assert_allclose(sparse[1:], np.sort(dense)[1:100], rtol=1e-8)


@pytest.mark.parametrize("scale", [1e-3, 1e4])
def test_scaling_and_moving(scale: float) -> None:
    moved = eigenpairs(laplace_beltrami(shapes.moved(shapes.body(3), seed=3, scale=scale)))
    here = eigenpairs(BODY)
    np.testing.assert_allclose(moved.eigenvalues * scale**2, here.eigenvalues, rtol=1e-8)
    np.testing.assert_allclose(moved.eigenvectors * scale, here.eigenvectors, atol=1e-6)


def test_lumped_mass_serves_as_well() -> None:
    operator = laplace_beltrami(shapes.body(3), mass="lumped")
    pairs = eigenpairs(operator)
    gram = pairs.eigenvectors.T @ (operator.mass @ pairs.eigenvectors)
    np.testing.assert_allclose(gram, np.eye(61), atol=1e-9)


def test_a_long_tube_hangs_together() -> None:
    ball = shapes.icosphere(3)
    tube = eigenpairs(laplace_beltrami(TriangleMesh(ball.vertices * [100, 1, 1], ball.faces)), 5)
    assert 0 < tube.eigenvalues[1] * tube.area < 0.5


# --- what has none ------------------------------------------------------------------------------------


def loose_end(operator: LaplaceBeltrami) -> LaplaceBeltrami:
    """With one more unknown that has neither stiffness nor mass."""
    nothing = csc_array((1, 1))
    return LaplaceBeltrami(
        csc_array(block_diag([operator.stiffness, nothing])), csc_array(block_diag([operator.mass, nothing]))
    )


@pytest.mark.parametrize("n", [1, 0, -3])
def test_one_pair_is_none(n: int) -> None:
    with pytest.raises(OptionError, match=f"n_pairs must be at least 2, got {n}"):
        eigenpairs(BODY, n)


def test_too_few_vertices() -> None:
    message = (
        r"^\[spectrum\] 61 eigenpairs need a surface of at least 62 vertices, got 42: use a finer surface or "
        r"fewer pairs"
    )
    with pytest.raises(SpectrumError, match=message):
        eigenpairs(laplace_beltrami(shapes.icosphere(1)))
    assert len(eigenpairs(laplace_beltrami(shapes.icosphere(1)), 41).eigenvalues) == 41


def test_two_components() -> None:
    two = laplace_beltrami(shapes.joined(shapes.icosphere(2), shapes.icosphere(2)))
    with pytest.raises(SpectrumError, match=r"the surface must be connected, got 2 components"):
        eigenpairs(two)


@pytest.mark.parametrize("level", [2, 3], ids=["dense", "sparse"])
def test_two_components_that_say_they_are_one(level: int) -> None:
    two = laplace_beltrami(shapes.joined(shapes.icosphere(level), shapes.icosphere(level)))
    with pytest.raises(
        SpectrumError, match=r"λ₁·area must be at least 1e-06, got .*: the surface is not conn"
    ):
        eigenpairs(LaplaceBeltrami(two.stiffness, two.mass), 100)


@pytest.mark.parametrize("n", [12, 250], ids=["sparse", "dense"])
def test_an_unknown_without_mass(n: int) -> None:
    with pytest.raises(
        SpectrumError, match=r"the eigenvalue solver failed: .*(singular|not positive definite)"
    ):
        eigenpairs(loose_end(BODY), n)


@pytest.mark.parametrize("n", [12, 250], ids=["sparse", "dense"])
def test_a_stiffness_of_the_wrong_sign(n: int) -> None:
    with pytest.raises(SpectrumError, match=r"λ₁·area must be at least 1e-06, got -"):
        eigenpairs(LaplaceBeltrami(-BODY.stiffness, BODY.mass), n)


def test_a_stiffness_that_is_not_symmetric() -> None:
    skewed = BODY.stiffness.tolil()
    skewed[0, 5] += 1
    with pytest.raises(SpectrumError, match=r"relative residuals must stay below 1e-05, got "):
        eigenpairs(LaplaceBeltrami(csc_array(skewed), BODY.mass), 12)
