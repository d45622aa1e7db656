"""The lowest eigenpairs of a Laplace–Beltrami operator."""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy.linalg import LinAlgError, eigh
from scipy.sparse import csc_array
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh, splu

from pcretrieve.errors import (
    ExtraZeroModes,
    NegativeEigenvalues,
    NonFiniteSpectrum,
    OptionError,
    SpectrumError,
    SpectrumNotConverged,
)
from pcretrieve.spectral.krylov import BLOCK, basis_size, block_krylov
from pcretrieve.types import Eigenpairs, FloatArray, LaplaceBeltrami

__all__ = ["eigenpairs"]

# The pencil is singular at 0, so it is factorised at a shift below it, times the area: far enough that
# S − σM is well conditioned and the zero mode does not drown the others, close enough that λ₁ (about 10) is
# still what the shift is near to. −0.01 and −10 take as many iterations.
RELATIVE_SHIFT = -1.0

# Lanczos finds the copies of a multiple eigenvalue one by one, the last of them late: on the sphere, 36 pairs
# asked for without guards come without one of the eleven that belong to l = 5.
GUARD_PAIRS = 8

# Residuals ‖S φ − λ M φ‖ / (λ ‖M φ‖) stay near the tolerance on sound surfaces; beyond this the pair is not
# one. At the largest tolerance eigenvalues are good to 1e-6, and signatures to 1e-5.
LARGEST_RESIDUAL = 1e-2
LARGEST_TOLERANCE = 1e-3

# λ₁ of a connected surface of unit area is at least 1e-3 for anything that a scanner sees (a tube a hundred
# times longer than wide has 5e-3); what lies below is another zero mode, and what rounding makes of zero.
SMALLEST_GAP = 1e-6


def eigenpairs(
    operator: LaplaceBeltrami,
    n_pairs: int = 61,
    *,
    solver: Literal["krylov", "arpack"] = "krylov",
    tolerance: float = 1e-4,
) -> Eigenpairs:
    """Solve S φ = λ M φ for the smallest λ.

    Parameters
    ----------
    operator : LaplaceBeltrami
        Of a connected surface; or with no component that has a zero mode (Dirichlet boundary).
    n_pairs : int, default 61
        How many, the constant one included.
    solver : {"krylov", "arpack"}, default "krylov"
        Block Krylov iteration on a sparse Cholesky factor (`block_krylov`), or shift-invert Lanczos by
        ARPACK [1]_ on SuperLU, four times slower, as a check. Where `n_pairs` is so large a share of the
        unknowns that neither has room, LAPACK's dense solver takes their place.
    tolerance : float, default 1e-4
        On the residuals ‖T φ − θ φ‖ / θ of T = (S − σM)⁻¹M, θ = 1/(λ − σ), σ = −1/area.
        `Eigenpairs.largest_residual`, that of S φ = λ M φ, comes out about as large; eigenvalues are off by
        its square, the 23 values of r-bihdm by 1e-8, those of any other spectral descriptor by less than
        1e-6. Each further digit costs 4 % of the time. ARPACK goes on to rounding whatever it is.

    Returns
    -------
    Eigenpairs
        Ascending, λ₀ = 0 exactly if there is a zero mode; ΦᵀMΦ = I. λ scales as length⁻², φ as length⁻¹.
        The sign of each φ with λ > 0 is such that its largest entry in magnitude is positive. Same input,
        same bits on one thread.

    Raises
    ------
    OptionError
        If fewer than 2 pairs are asked for, the tolerance is not between 0 and 1e-3, or `solver` is neither.
    ExtraZeroModes
        If the surface is not connected.
    NegativeEigenvalues
        If the stiffness matrix is not positive semi-definite.
    SpectrumNotConverged
        If the residuals do not fall below the tolerance.
    NonFiniteSpectrum
        If numbers overflow.
    SpectrumError
        If the operator has fewer than `n_pairs` + 1 unknowns, an unknown has no mass, the solver fails
        otherwise, or what it gives are no eigenpairs.

    References
    ----------
    .. [1] Lehoucq, Sorensen and Yang, "ARPACK users' guide", SIAM 1998.
    """
    _check_question(operator, n_pairs, tolerance)
    if solver not in ("krylov", "arpack"):
        raise OptionError(f"solver must be 'krylov' or 'arpack', got {solver!r}")
    room = basis_size(n_pairs) + BLOCK
    used = solver if operator.mass.shape[0] >= room else "dense"
    try:
        # Overflow is found by what comes out.
        with np.errstate(over="ignore", invalid="ignore"):
            eigenvalues, vectors, iterations = BACKENDS[used](operator, n_pairs, tolerance)
    except ArpackNoConvergence as error:
        raise SpectrumNotConverged(f"ARPACK must converge to rounding, did not: {error}") from error
    # SuperLU has no exception of its own: a singular matrix is a RuntimeError, as ArpackError is.
    except (LinAlgError, RuntimeError) as error:
        raise SpectrumError(f"the eigenvalue solver failed: {error}") from error
    largest_residual = _check_answer(operator, eigenvalues, vectors)

    # The zero mode is known: say so, instead of keeping the solver's rounding.
    if operator.n_components:
        eigenvalues[0] = 0.0
        vectors[:, 0] = 1 / np.sqrt(operator.area)
    vectors *= np.where(vectors.max(axis=0) >= -vectors.min(axis=0), 1.0, -1.0)
    return Eigenpairs(
        eigenvalues=eigenvalues,
        eigenvectors=vectors,
        mass=operator.mass,
        largest_residual=largest_residual,
        iterations=iterations,
        solver=used,
    )


def _check_question(operator: LaplaceBeltrami, n_pairs: int, tolerance: float) -> None:
    n = operator.stiffness.shape[0]
    if n_pairs < 2:
        raise OptionError(f"n_pairs must be at least 2, got {n_pairs}")
    if not 0 < tolerance <= LARGEST_TOLERANCE:
        raise OptionError(f"tolerance must be above 0 and at most {LARGEST_TOLERANCE:g}, got {tolerance:g}")
    if n <= n_pairs:
        raise SpectrumError(
            f"{n_pairs} eigenpairs need a surface of at least {n_pairs + 1} vertices, got {n}: "
            "use a finer surface or fewer pairs"
        )
    if operator.n_components > 1:
        raise ExtraZeroModes(
            f"the surface must be connected, got {operator.n_components} components: each has a zero "
            "eigenvalue of its own; keep the largest one"
        )
    n_massless = int((operator.mass.diagonal() <= 0).sum())
    if n_massless:
        raise SpectrumError(f"every unknown must have mass, got {n_massless} of {n} without")


def _dense(operator: LaplaceBeltrami, n_pairs: int, _: float) -> tuple[FloatArray, FloatArray, int]:
    eigenvalues, vectors = eigh(
        operator.stiffness.toarray(),
        operator.mass.toarray(),
        subset_by_index=[0, n_pairs - 1],
        check_finite=False,
    )
    return eigenvalues, vectors, 0


def _krylov(operator: LaplaceBeltrami, n_pairs: int, tolerance: float) -> tuple[FloatArray, FloatArray, int]:
    return block_krylov(
        operator.stiffness,
        operator.mass,
        n_pairs,
        shift=RELATIVE_SHIFT / operator.area,
        tolerance=tolerance,
    )


def _arpack(operator: LaplaceBeltrami, n_pairs: int, _: float) -> tuple[FloatArray, FloatArray, int]:
    stiffness, mass = operator.stiffness, operator.mass
    n = stiffness.shape[0]
    shift = RELATIVE_SHIFT / operator.area
    # The shifted matrix is symmetric positive definite: its diagonal can be the pivot, and an ordering for
    # symmetric patterns fills in a third of what the default one does.
    factor = splu(
        csc_array(stiffness - shift * mass),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    n_solves = 0

    def solve(right: FloatArray) -> FloatArray:
        nonlocal n_solves
        n_solves += 1
        return factor.solve(right)

    eigenvalues, vectors = eigsh(
        stiffness,
        k=n_pairs + GUARD_PAIRS,
        M=mass,
        sigma=shift,
        OPinv=LinearOperator((n, n), matvec=solve, dtype=np.float64),
        # ARPACK's own start is random; a fixed one makes the answer reproducible. It must have a part
        # in every eigenspace, so it must not be symmetric where the surface is.
        v0=np.random.default_rng(0).standard_normal(n),
        # To rounding: what it finds at a looser tolerance lacks copies in spite of the guards.
        tol=0.0,
    )
    order = np.argsort(eigenvalues)[:n_pairs]
    return eigenvalues[order], vectors[:, order], n_solves


BACKENDS = {"krylov": _krylov, "arpack": _arpack, "dense": _dense}


def _check_answer(operator: LaplaceBeltrami, eigenvalues: FloatArray, vectors: FloatArray) -> float:
    """The largest relative residual of the pairs with λ > 0."""
    scaled = eigenvalues * operator.area  # dimensionless
    if not (np.isfinite(scaled).all() and np.isfinite(vectors).all()):
        raise NonFiniteSpectrum("eigenpairs must be finite, got NaN or infinite numbers")
    if scaled[0] < -SMALLEST_GAP:
        raise NegativeEigenvalues(
            f"λ·area must not be negative, got {scaled[0]:.1e}: the stiffness matrix is not positive "
            "semi-definite"
        )
    n_zero = operator.n_components
    if scaled[n_zero] < SMALLEST_GAP:
        raise ExtraZeroModes(
            f"λ·area must be at least {SMALLEST_GAP:g} after {n_zero} zero modes, got {scaled[n_zero]:.1e}: "
            "the surface is not connected, or hangs by a thread"
        )
    if n_zero and scaled[0] > SMALLEST_GAP:
        raise SpectrumError(
            f"a connected surface must have the eigenvalue 0, got λ₀·area = {scaled[0]:.1e}: the rows of the "
            "stiffness matrix must sum up to 0, or n_components be 0"
        )
    mapped = operator.mass @ vectors  # (n, k)
    size = eigenvalues * np.linalg.norm(mapped, axis=0)  # (k,)
    mapped *= eigenvalues
    residual = np.linalg.norm(operator.stiffness @ vectors - mapped, axis=0)
    largest = float((residual[n_zero:] / size[n_zero:]).max())
    if not largest <= LARGEST_RESIDUAL:
        raise SpectrumError(f"relative residuals must stay below {LARGEST_RESIDUAL}, got {largest:.1e}")
    return largest
