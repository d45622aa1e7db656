"""Eigenpairs: orthonormal, ordered and reproducible with every solver; and operators without a spectrum."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Literal, get_args

import numpy as np
import pytest
import shapes
from scipy.linalg import eigh
from scipy.sparse import block_diag, csc_array, diags_array
from scipy.sparse.linalg import eigsh

from pcretrieve.errors import OptionError, SpectrumError
from pcretrieve.spectral import eigen, eigenpairs, krylov, laplace_beltrami
from pcretrieve.values import FloatArray, LaplaceBeltrami

Solver = Literal["krylov", "arpack"]

BODY = laplace_beltrami(shapes.body(3))


@pytest.fixture(params=get_args(Solver))
def solver(request: pytest.FixtureRequest) -> Solver:
    name: Solver = request.param
    return name


@pytest.fixture(params=[12, 250], ids=lambda n: f"{n} pairs")  # the last of them by the dense route
def n_pairs(request: pytest.FixtureRequest) -> int:
    n: int = request.param
    return n


def dense_eigenvalues(operator: LaplaceBeltrami) -> FloatArray:
    eigenvalues: FloatArray = eigh(operator.stiffness.toarray(), operator.mass.toarray(), eigvals_only=True)
    return eigenvalues


# --- what they are ------------------------------------------------------------------------------------


def test_orthonormal_ascending_and_from_zero(n_pairs: int, solver: Solver) -> None:
    pairs = eigenpairs(BODY, n_pairs, solver=solver)
    phi = pairs.eigenvectors
    assert phi.shape == (BODY.mass.shape[0], n_pairs)
    np.testing.assert_allclose(phi.T @ (BODY.mass @ phi), np.eye(n_pairs), atol=1e-9)
    assert pairs.eigenvalues[0] == 0
    assert (np.diff(pairs.eigenvalues) > 0).all()  # nothing about the body is symmetric
    assert (phi[:, 0] == 1 / np.sqrt(pairs.area)).all()


def test_residuals_are_what_was_asked_for(n_pairs: int, solver: Solver) -> None:
    pairs = eigenpairs(BODY, n_pairs, solver=solver, tolerance=1e-10)
    lam, phi = pairs.eigenvalues[1:], pairs.eigenvectors[:, 1:]
    mapped = BODY.mass @ phi
    size = lam * np.linalg.norm(mapped, axis=0)
    largest = (np.linalg.norm(BODY.stiffness @ phi - lam * mapped, axis=0) / size).max()
    assert largest == pytest.approx(pairs.largest_residual, rel=0.5)
    assert largest < 1e-9


def test_the_same_bits_each_time(n_pairs: int, solver: Solver) -> None:
    one, two = (
        eigenpairs(operator, n_pairs, solver=solver) for operator in (BODY, laplace_beltrami(shapes.body(3)))
    )
    assert (one.eigenvalues == two.eigenvalues).all()
    assert (one.eigenvectors == two.eigenvectors).all()


def test_all_routes_agree(solver: Solver) -> None:
    operator = laplace_beltrami(shapes.body(3), mass="lumped")
    sparse, dense = eigenpairs(operator, 61, solver=solver, tolerance=1e-9), eigenpairs(operator, 250)
    np.testing.assert_allclose(sparse.eigenvalues[1:], dense.eigenvalues[1:61], rtol=1e-10)
    np.testing.assert_allclose(sparse.eigenvectors, dense.eigenvectors[:, :61], atol=1e-6)


def test_orthogonality_is_kept_through_restarts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(krylov, "VECTORS_PER_PAIR", 1)
    monkeypatch.setattr(krylov, "SPARE_VECTORS", 6 * krylov.BLOCK)
    pairs = eigenpairs(BODY, 61)
    assert pairs.iterations * krylov.BLOCK > 1.5 * krylov.basis_size(61)
    phi = pairs.eigenvectors
    np.testing.assert_allclose(phi.T @ (BODY.mass @ phi), np.eye(61), atol=1e-10)


def test_scaling_and_moving(solver: Solver) -> None:
    scale = 1e4
    there = laplace_beltrami(shapes.moved(shapes.body(3), seed=3, scale=scale))
    moved, here = (eigenpairs(each, solver=solver, tolerance=1e-9) for each in (there, BODY))
    np.testing.assert_allclose(moved.eigenvalues * scale**2, here.eigenvalues, rtol=1e-8)
    np.testing.assert_allclose(moved.eigenvectors * scale, here.eigenvectors, atol=1e-6)


# --- clusters -----------------------------------------------------------------------------------------

# A Krylov space of one vector has one eigenvector of each multiple eigenvalue only.


def test_all_of_a_symmetric_surface_are_found(solver: Solver) -> None:
    # The 120 symmetries of the icosahedron make eigenvalues up to fivefold.
    sphere = laplace_beltrami(shapes.icosphere(3))
    for tolerance, error in ((1e-4, 1e-8), (1e-6, 1e-9)):
        pairs = eigenpairs(sphere, 100, solver=solver, tolerance=tolerance)
        assert pairs.solver == solver
        np.testing.assert_allclose(pairs.eigenvalues[1:], dense_eigenvalues(sphere)[1:100], rtol=error)


def test_copies_beyond_the_block_are_found() -> None:
    # Ten equal bodies with weak links: clusters of ten eigenvalues, more than a block has vectors.
    ten = laplace_beltrami(shapes.joined(*[shapes.body(2)] * 10))
    n = ten.mass.shape[0] // 10
    links = np.where(np.arange(9 * n) % n == 0, 0.1, 0.0)
    path = csc_array(np.diag(-links, n) + np.diag(-links, -n))
    linked = LaplaceBeltrami(csc_array(ten.stiffness + path - diags_array(path.sum(axis=1))), ten.mass)
    # The last cluster is not complete: with the larger tolerance its values, equal to five digits, are mixed.
    for tolerance, error in ((1e-4, 1e-6), (1e-6, 1e-9)):
        pairs = eigenpairs(linked, 61, tolerance=tolerance)
        assert pairs.solver == "krylov"
        np.testing.assert_allclose(pairs.eigenvalues[1:], dense_eigenvalues(linked)[1:61], rtol=error)


# --- no zero mode -------------------------------------------------------------------------------------


def test_without_a_zero_mode_nothing_is_pinned(n_pairs: int, solver: Solver) -> None:
    # One vertex held: the matrices without its row and column.
    held = LaplaceBeltrami(csc_array(BODY.stiffness[1:, 1:]), csc_array(BODY.mass[1:, 1:]), n_components=0)
    pairs = eigenpairs(held, n_pairs, solver=solver, tolerance=1e-6)
    np.testing.assert_allclose(pairs.eigenvalues, dense_eigenvalues(held)[:n_pairs], rtol=1e-9)
    phi = pairs.eigenvectors
    assert phi[:, 0].std() > 0.01 * phi[:, 0].mean() > 0
    np.testing.assert_allclose(phi.T @ (held.mass @ phi), np.eye(n_pairs), atol=1e-9)


# --- what has none ------------------------------------------------------------------------------------


def loose_end(operator: LaplaceBeltrami) -> LaplaceBeltrami:
    """The matrices with one more row, without stiffness and mass."""
    nothing = csc_array((1, 1))
    return LaplaceBeltrami(
        csc_array(block_diag([operator.stiffness, nothing])), csc_array(block_diag([operator.mass, nothing]))
    )


def test_questions_without_an_answer() -> None:
    for n in (1, -3):
        with pytest.raises(OptionError, match=f"n_pairs must be at least 2, got {n}"):
            eigenpairs(BODY, n)
    for tolerance in (0, 1e-2, np.nan):
        with pytest.raises(OptionError, match=r"tolerance must be above 0 and at most 0\.001, got "):
            eigenpairs(BODY, tolerance=tolerance)
    with pytest.raises(OptionError, match="solver must be 'krylov' or 'arpack', got 'dense'"):
        eigenpairs(BODY, solver="dense")  # type: ignore[arg-type]


def test_too_few_vertices() -> None:
    message = (
        r"^\[spectrum\] 61 eigenpairs need a surface of at least 62 vertices, got 42: use a finer surface or "
        r"fewer pairs"
    )
    with pytest.raises(SpectrumError, match=message):
        eigenpairs(laplace_beltrami(shapes.icosphere(1)))
    assert len(eigenpairs(laplace_beltrami(shapes.icosphere(1)), 41).eigenvalues) == 41


@pytest.mark.parametrize("level", [2, 3], ids=["dense", "sparse"])
def test_two_components_that_say_they_are_one(level: int, solver: Solver) -> None:
    two = laplace_beltrami(shapes.joined(shapes.icosphere(level), shapes.icosphere(level)))
    message = r"at least 1e-06 after 1 zero modes, got .*: the surface is not"
    with pytest.raises(SpectrumError, match=message):
        eigenpairs(replace(two, n_components=1), 100, solver=solver)


@pytest.mark.parametrize("n", [12, 250], ids=["sparse", "dense"])
def test_an_unknown_without_mass(n: int) -> None:
    with pytest.raises(SpectrumError, match=r"every unknown must have mass, got 1 of 643 without"):
        eigenpairs(loose_end(BODY), n)


@pytest.mark.parametrize("n", [12, 250], ids=["sparse", "dense"])
def test_a_mass_that_is_not_definite(n: int, solver: Solver) -> None:
    mass = BODY.mass.tolil()
    mass[3, 5] = mass[5, 3] = 1.0
    with pytest.raises(SpectrumError):
        eigenpairs(LaplaceBeltrami(BODY.stiffness, csc_array(mass)), n, solver=solver)


@pytest.mark.parametrize("n", [12, 250], ids=["sparse", "dense"])
@pytest.mark.parametrize("amount", [1.0, 0.5 / dense_eigenvalues(BODY)[-1] / BODY.area], ids=["far", "near"])
def test_a_stiffness_of_the_wrong_sign(n: int, amount: float, solver: Solver) -> None:
    # The near ones are above the shift, so that there is a Cholesky factor.
    with pytest.raises(SpectrumError, match=r"(must not be negative, got -|must be positive definite)"):
        eigenpairs(LaplaceBeltrami(-amount * BODY.stiffness, BODY.mass), n, solver=solver)


def test_overflow() -> None:
    with pytest.raises(SpectrumError, match="got overflow or NaN"):
        eigenpairs(LaplaceBeltrami(BODY.stiffness, csc_array(BODY.mass * 1e200)), 12)


def test_a_stiffness_that_is_not_symmetric(solver: Solver) -> None:
    skewed = BODY.stiffness.tolil()
    skewed[0, 5] += 1
    with pytest.raises(SpectrumError):
        eigenpairs(LaplaceBeltrami(csc_array(skewed), BODY.mass), 12, solver=solver)


def test_a_tolerance_beyond_arithmetic() -> None:
    message = r"residuals must fall below 1e-25, got .* after 82 blocks"
    with pytest.raises(SpectrumError, match=message):
        eigenpairs(BODY, 12, tolerance=1e-25)


def test_arpack_that_runs_out_of_iterations(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(eigen, "eigsh", partial(eigsh, maxiter=1, ncv=72))
    with pytest.raises(SpectrumError, match=r"ARPACK .*No convergence"):
        eigenpairs(BODY, 61, solver="arpack")
