"""The smallest eigenpairs of a Laplace–Beltrami operator."""

from __future__ import annotations

from contextlib import suppress
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, eigh

from pcretrieve.errors import OptionError, SpectrumError
from pcretrieve.spectral.blocks import BLOCK
from pcretrieve.spectral.krylov import basis_size, block_krylov
from pcretrieve.values import Eigenpairs, FloatArray, LaplaceBeltrami
from pcretrieve.values.base import check_type

# The shift σ of shift-invert iteration, times the area. S is singular, and S − σM is factorised instead with
# σ < 0. |σ| is small enough that it is near to λ_1 (about 10 / area), and large enough that S − σM is well
# conditioned and θ_0 does not exceed the other θ by orders of magnitude.
RELATIVE_SHIFT = -1.0

# Largest residual ‖S φ − λ M φ‖ / (λ ‖M φ‖) that is accepted; on valid surfaces it is near the tolerance.
# With the largest tolerance the relative error of eigenvalues is 1e-6, and of signatures 1e-5.
LARGEST_RESIDUAL = 1e-2
LARGEST_TOLERANCE = 1e-3

# Smallest λ_1 · area of a connected surface. A tube that is a hundred times longer than wide has 5e-3; a
# smaller value by orders of magnitude is a second zero eigenvalue with rounding errors.
SMALLEST_GAP = 1e-6


class Found(NamedTuple):
    """Eigenpairs: (k,) and (n, k), the number of blocks, and the largest relative residual."""

    eigenvalues: FloatArray
    vectors: FloatArray
    iterations: int
    residual: float


def eigenpairs(
    operator: LaplaceBeltrami, n_pairs: int = 61, *, tolerance: float = 1e-4
) -> Eigenpairs:
    """The smallest eigenvalues λ of S φ = λ M φ, and their eigenvectors φ.

    Parameters
    ----------
    operator : LaplaceBeltrami
        The operator of a connected surface; or any operator with the Dirichlet boundary condition.
    n_pairs : int, default 61
        Number of eigenpairs, including the constant eigenfunction; at least 2.
    tolerance : float, default 1e-4
        Largest residual ‖T φ − θ φ‖ / θ of T = (S − σM)⁻¹M, with θ = 1/(λ − σ) and σ = −1/area; above 0, at
        most 1e-3. `Eigenpairs.largest_residual`, the residual of S φ = λ M φ, is of about the same size. The
        error of eigenvalues is of the order of its square.

    Returns
    -------
    Eigenpairs
        Eigenvalues ascending, unit length⁻², λ_0 = 0 exactly with the Neumann boundary condition;
        eigenvectors with ΦᵀMΦ = I, unit length⁻¹. The entry of largest magnitude of each φ with λ > 0 is
        positive. Equal inputs give equal results, bit for bit, on one thread.

    Raises
    ------
    OptionError
        If `n_pairs` is less than 2, or the tolerance is out of range.
    SpectrumError
        If the operator has at most `n_pairs` rows, or a row has no mass; the surface is not connected; the
        stiffness matrix is not positive semi-definite; a number overflows; or the solver fails, its residuals
        do not decrease below the tolerance, or its results are not eigenpairs.
    """
    _check_question(operator, n_pairs, tolerance)
    # LAPACK's dense solver, if the operator has too few rows for the iteration.
    used = "krylov" if operator.mass.shape[0] >= basis_size(n_pairs) + BLOCK else "dense"
    try:
        # Overflow is detected in the results.
        with np.errstate(over="ignore", invalid="ignore"):
            found = (
                _krylov(operator, n_pairs, tolerance)
                if used == "krylov"
                else _checked(operator, *_dense(operator, n_pairs))
            )
    # SuperLU raises RuntimeError for a singular matrix.
    except (LinAlgError, RuntimeError) as error:
        raise SpectrumError(f"the eigenvalue solver failed: {error}") from error
    eigenvalues, vectors, iterations, largest_residual = found

    # The zero eigenvalue and its eigenvector are known exactly, and replace the computed ones.
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
    check_type("operator", operator, LaplaceBeltrami)
    check_type("n_pairs", n_pairs, int, np.integer)
    n = operator.stiffness.shape[0]
    if n_pairs < 2:
        raise OptionError(f"n_pairs must be at least 2, got {n_pairs}")
    if not 0 < tolerance <= LARGEST_TOLERANCE:
        raise OptionError(
            f"tolerance must be above 0 and at most {LARGEST_TOLERANCE:g}, got {tolerance:g}"
        )
    if n <= n_pairs:
        raise SpectrumError(
            f"{n_pairs} eigenpairs need a surface of at least {n_pairs + 1} vertices, got {n}: "
            "use a finer surface or fewer pairs"
        )
    if operator.n_components > 1:
        raise SpectrumError(
            f"the surface must be connected, got {operator.n_components} components: each has a zero "
            "eigenvalue of its own; keep the largest one"
        )
    n_massless = int((operator.mass.diagonal() <= 0).sum())
    if n_massless:
        raise SpectrumError(
            f"every unknown must have mass, got {n_massless} of {n} without"
        )


def _krylov(operator: LaplaceBeltrami, n_pairs: int, tolerance: float) -> Found:
    """By a shift amid the wanted eigenvalues, 4πk / area by Weyl's law; else by one below all of them.

    Without pivoting, the first shift loses digits if it is near to an eigenvalue of a part of the matrix.
    """
    shift, last = 2 * np.pi * n_pairs / operator.area, RELATIVE_SHIFT / operator.area
    with suppress(SpectrumError, LinAlgError, RuntimeError):
        found = block_krylov(operator, n_pairs, shift=shift, tolerance=tolerance)
        return _checked(operator, *found)
    found = block_krylov(operator, n_pairs, shift=last, tolerance=tolerance)
    return _checked(operator, *found)


def _dense(operator: LaplaceBeltrami, n_pairs: int) -> tuple[FloatArray, FloatArray, int]:
    stiffness, mass = operator.stiffness.toarray(), operator.mass.toarray()
    eigenvalues, vectors = eigh(
        stiffness, mass, subset_by_index=[0, n_pairs - 1], check_finite=False
    )
    return eigenvalues, vectors, 0


def _checked(
    operator: LaplaceBeltrami,
    eigenvalues: FloatArray,
    vectors: FloatArray,
    iterations: int,
) -> Found:
    """The eigenpairs that a solver found, if they are some, with the largest residual of those with λ > 0."""
    scaled = eigenvalues * operator.area  # dimensionless
    if not (np.isfinite(scaled).all() and np.isfinite(vectors).all()):
        raise SpectrumError("eigenpairs must be finite, got NaN or infinite numbers")
    if scaled[0] < -SMALLEST_GAP:
        raise SpectrumError(
            f"λ·area must not be negative, got {scaled[0]:.1e}: the stiffness matrix is not positive "
            "semi-definite"
        )
    n_zero = operator.n_components
    if scaled[n_zero] < SMALLEST_GAP:
        raise SpectrumError(
            f"λ·area must be at least {SMALLEST_GAP:g} after {n_zero} zero modes, got {scaled[n_zero]:.1e}: "
            "the surface is not connected, or only by a very thin bridge"
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
        raise SpectrumError(
            f"relative residuals must stay below {LARGEST_RESIDUAL}, got {largest:.1e}"
        )
    return Found(eigenvalues, vectors, iterations, largest)
