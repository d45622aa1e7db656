"""Eigenpairs: orthonormal, ordered and reproducible with every solver; and operators without a spectrum."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import shapes
from scipy.linalg import eigh
from scipy.sparse import csc_array, diags_array

from pcretrieve.errors import OptionError, SpectrumError
from pcretrieve.spectral import blocks, eigenpairs, krylov, laplace_beltrami
from pcretrieve.values import FloatArray, LaplaceBeltrami

BODY = laplace_beltrami(shapes.body(3))


@pytest.fixture(params=[12, 250], ids=["sparse", "dense"])
def n_pairs(request: pytest.FixtureRequest) -> Any:
    return request.param


def dense_eigenvalues(operator: LaplaceBeltrami) -> FloatArray:
    eigenvalues: FloatArray = eigh(
        operator.stiffness.toarray(), operator.mass.toarray(), eigvals_only=True
    )
    return eigenvalues


def test_orthonormal_ascending_from_zero_and_the_same_bits_each_time(
    n_pairs: int,
) -> None:
    pairs, again = (
        eigenpairs(operator, n_pairs, tolerance=1e-10)
        for operator in (BODY, laplace_beltrami(shapes.body(3)))
    )
    assert again == pairs
    lam, phi = pairs.eigenvalues, pairs.eigenvectors
    assert phi.shape == (BODY.mass.shape[0], n_pairs)
    np.testing.assert_allclose(phi.T @ (BODY.mass @ phi), np.eye(n_pairs), atol=1e-9)
    assert lam[0] == 0
    assert (np.diff(lam) > 0).all()  # nothing about the body is symmetric
    assert (phi[:, 0] == 1 / np.sqrt(pairs.area)).all()
    mapped = (BODY.mass @ phi * lam)[:, 1:]
    residuals = np.linalg.norm(
        (BODY.stiffness @ phi)[:, 1:] - mapped, axis=0
    ) / np.linalg.norm(mapped, axis=0)
    assert residuals.max() == pytest.approx(pairs.largest_residual, rel=0.5)
    assert residuals.max() < 1e-9


@pytest.mark.slow
def test_a_shift_that_costs_digits_is_followed_by_another() -> None:
    """The first pivots of S − σM, without pivoting, are those of the vertices with fewest neighbours."""
    operator, n_pairs = laplace_beltrami(shapes.icosphere(4), mass="lumped"), 61
    mass = operator.mass.diagonal().copy()
    for _ in range(50):  # because σ depends on the area
        shift = 2 * np.pi * n_pairs / mass.sum()
        mass[:12] = operator.stiffness.diagonal()[:12] * (1 - 1e-10) / shift
    changed = LaplaceBeltrami(operator.stiffness, csc_array(diags_array(mass)))
    found = eigenpairs(changed, n_pairs).eigenvalues
    np.testing.assert_allclose(found[1:], dense_eigenvalues(changed)[1:61], rtol=1e-7)


def test_all_routes_agree() -> None:
    operator = laplace_beltrami(shapes.body(3), mass="lumped")
    sparse, dense = eigenpairs(operator, 61, tolerance=1e-9), eigenpairs(operator, 250)
    np.testing.assert_allclose(
        sparse.eigenvalues[1:], dense.eigenvalues[1:61], rtol=1e-10
    )
    np.testing.assert_allclose(sparse.eigenvectors, dense.eigenvectors[:, :61], atol=1e-6)


def test_orthogonality_is_kept_through_restarts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(krylov, "VECTORS_PER_PAIR", 1)
    monkeypatch.setattr(krylov, "SPARE_VECTORS", 6 * blocks.BLOCK)
    pairs = eigenpairs(BODY, 61, tolerance=1e-6)
    assert pairs.iterations * blocks.BLOCK > 1.5 * krylov.basis_size(61)
    phi = pairs.eigenvectors
    np.testing.assert_allclose(phi.T @ (BODY.mass @ phi), np.eye(61), atol=1e-10)


def test_scaling_and_moving() -> None:
    scale = 1e4
    there = laplace_beltrami(shapes.moved(shapes.body(3), seed=3, scale=scale))
    moved, here = (eigenpairs(each, tolerance=1e-9) for each in (there, BODY))
    np.testing.assert_allclose(moved.eigenvalues * scale**2, here.eigenvalues, rtol=1e-8)
    np.testing.assert_allclose(moved.eigenvectors * scale, here.eigenvectors, atol=1e-6)


def test_all_of_a_symmetric_surface_are_found() -> None:
    # The 120 symmetries of the icosahedron make eigenvalues up to fivefold; a Krylov space of one vector has
    # one eigenvector of each.
    sphere = laplace_beltrami(shapes.icosphere(3))
    for tolerance, error in ((1e-4, 1e-8), (1e-6, 1e-9)):
        pairs = eigenpairs(sphere, 100, tolerance=tolerance)
        assert pairs.solver == "krylov"
        np.testing.assert_allclose(
            pairs.eigenvalues[1:], dense_eigenvalues(sphere)[1:100], rtol=error
        )


def test_copies_beyond_the_block_are_found() -> None:
    # Ten equal bodies with weak links: clusters of ten eigenvalues, more than a block has vectors.
    ten = laplace_beltrami(shapes.joined(*[shapes.body(2)] * 10))
    n = ten.mass.shape[0] // 10
    links = np.where(np.arange(9 * n) % n == 0, 0.1, 0.0)
    path = csc_array(np.diag(-links, n) + np.diag(-links, -n))
    linked = LaplaceBeltrami(
        csc_array(ten.stiffness + path - diags_array(path.sum(axis=1))), ten.mass
    )
    # The last cluster is not complete: with the larger tolerance its values, equal to five digits, are mixed.
    for tolerance, error in ((1e-4, 1e-6), (1e-6, 1e-9)):
        pairs = eigenpairs(linked, 61, tolerance=tolerance)
        assert pairs.solver == "krylov"
        np.testing.assert_allclose(
            pairs.eigenvalues[1:], dense_eigenvalues(linked)[1:61], rtol=error
        )


def test_without_a_zero_mode_nothing_is_pinned(n_pairs: int) -> None:
    # One vertex held: the matrices without its row and column.
    held = LaplaceBeltrami(
        csc_array(BODY.stiffness[1:, 1:]), csc_array(BODY.mass[1:, 1:]), n_components=0
    )
    pairs = eigenpairs(held, n_pairs, tolerance=1e-6)
    np.testing.assert_allclose(
        pairs.eigenvalues, dense_eigenvalues(held)[:n_pairs], rtol=1e-9
    )
    phi = pairs.eigenvectors
    assert phi[:, 0].std() > 0.01 * phi[:, 0].mean() > 0
    np.testing.assert_allclose(phi.T @ (held.mass @ phi), np.eye(n_pairs), atol=1e-9)


# --- what has none ------------------------------------------------------------------------------------


def edited(matrix: csc_array, value: float, *places: tuple[int, int]) -> csc_array:
    changed = matrix.tolil()
    for place in places:
        changed[place] = value
    return csc_array(changed)


TWO = laplace_beltrami(shapes.joined(shapes.icosphere(2), shapes.icosphere(2)))
STIFFNESS, MASS = BODY.stiffness, BODY.mass
NEGATIVE = r"(must not be negative, got -|must be positive definite)"
BROKEN = {
    "two parts": (
        TWO.stiffness,
        TWO.mass,
        "at least 1e-06 after 1 zero modes, got .*: the surface is not",
    ),
    "massless": (
        STIFFNESS,
        edited(MASS, 0, (3, 3)),
        "must have mass, got 1 of 642 without",
    ),
    "indefinite": (
        STIFFNESS,
        edited(MASS, 1, (3, 5), (5, 3)),
        "solver failed|must not be negative",
    ),
    "skewed": (
        edited(STIFFNESS, 1, (0, 5)),
        MASS,
        "eigenvalue 0|residuals must stay|must not be neg",
    ),
    "negative": (-STIFFNESS, MASS, NEGATIVE),
    # Above the shift, so that there is a Cholesky factor.
    "just negative": (
        -0.5 / dense_eigenvalues(BODY)[-1] / BODY.area * STIFFNESS,
        MASS,
        NEGATIVE,
    ),
}


@pytest.mark.parametrize("name", BROKEN)
def test_an_operator_without_a_spectrum(name: str, n_pairs: int) -> None:
    stiffness, mass, message = BROKEN[name]
    with pytest.raises(SpectrumError, match=message):
        eigenpairs(LaplaceBeltrami(csc_array(stiffness), csc_array(mass)), n_pairs)


def test_questions_without_an_answer() -> None:
    for error, n_pairs, tolerance, message in (
        (OptionError, 1, 1e-4, "n_pairs must be at least 2, got 1"),
        (OptionError, 12, 0, r"tolerance must be above 0 and at most 0\.001, got 0"),
        (
            OptionError,
            12,
            1e-2,
            r"tolerance must be above 0 and at most 0\.001, got 0\.01",
        ),
        (
            OptionError,
            12,
            np.nan,
            r"tolerance must be above 0 and at most 0\.001, got nan",
        ),
        (
            SpectrumError,
            642,
            1e-4,
            r"^\[spectrum\] 642 .* need a surface of at least 643 vertices, got 642",
        ),
        (
            SpectrumError,
            12,
            1e-25,
            "residuals must fall below 1e-25, got .* after 82 blocks",
        ),
    ):
        with pytest.raises(error, match=message):
            eigenpairs(BODY, n_pairs, tolerance=tolerance)
    with pytest.raises(SpectrumError, match="got overflow or NaN"):
        eigenpairs(LaplaceBeltrami(STIFFNESS, csc_array(MASS * 1e200)), 12)
    assert (
        len(eigenpairs(laplace_beltrami(shapes.icosphere(1)), 41).eigenvalues) == 41
    )  # of 42 vertices
