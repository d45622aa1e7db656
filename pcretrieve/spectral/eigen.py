"""The lowest eigenpairs of a Laplace–Beltrami operator."""

from __future__ import annotations

import numpy as np
from scipy.linalg import LinAlgError, eigh
from scipy.sparse import csc_array
from scipy.sparse.linalg import LinearOperator, eigsh, splu

from pcretrieve.errors import OptionError, SpectrumError
from pcretrieve.types import Eigenpairs, FloatArray, LaplaceBeltrami

__all__ = ["eigenpairs"]

# The pencil is singular at 0, so it is factorised at a shift just below it: far enough that S − σM is well
# conditioned, close enough that λ₁ (about 10 on a surface of unit area) is still what the shift is near to.
RELATIVE_SHIFT = -1e-2

# Below this many unknowns per pair ARPACK has no room for its Krylov space, and the dense problem is as fast.
DENSE_UNKNOWNS_PER_PAIR = 4

# Lanczos finds the copies of a multiple eigenvalue one by one, the last of them late: on the sphere, 36 pairs
# asked for without guards come without one of the eleven that belong to l = 5.
GUARD_PAIRS = 8

# Residuals ‖S φ − λ M φ‖ / (λ ‖M φ‖) stay near 1e-10 on sound surfaces; beyond this the pair is not one.
LARGEST_RESIDUAL = 1e-5

# λ₁ of a connected surface of unit area is at least 1e-3 for anything that a scanner sees (a tube a hundred
# times longer than wide has 5e-3); what lies below is another zero mode.
SMALLEST_GAP = 1e-6


def eigenpairs(operator: LaplaceBeltrami, n_pairs: int = 61) -> Eigenpairs:
    """Solve S φ = λ M φ for the smallest λ by shift-invert Lanczos [1]_.

    Parameters
    ----------
    operator : LaplaceBeltrami
        Of a connected surface.
    n_pairs : int, default 61
        How many, the constant one included.

    Returns
    -------
    Eigenpairs
        Ascending, λ₀ = 0 exactly; ΦᵀMΦ = I. λ scales as length⁻², φ as length⁻¹. The sign of each φ with
        λ > 0 is such that its largest entry in magnitude is positive. Same input, same bits on one thread.

    Raises
    ------
    OptionError
        If fewer than 2 pairs are asked for.
    SpectrumError
        If the operator has fewer than `n_pairs` + 1 unknowns or is not connected, the solver fails, or what
        it gives are no eigenpairs.

    References
    ----------
    .. [1] Lehoucq, Sorensen and Yang, "ARPACK users' guide", SIAM 1998.
    """
    n = operator.stiffness.shape[0]
    if n_pairs < 2:
        raise OptionError(f"n_pairs must be at least 2, got {n_pairs}")
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
    solve = _dense if n < DENSE_UNKNOWNS_PER_PAIR * (n_pairs + GUARD_PAIRS) else _shift_invert
    try:
        eigenvalues, vectors = solve(operator, n_pairs)
    # SuperLU has no exception of its own: a singular matrix is a RuntimeError, as ArpackError is.
    except (LinAlgError, RuntimeError) as error:
        raise SpectrumError(f"the eigenvalue solver failed: {error}") from error
    return _checked(operator, eigenvalues, vectors)


def _dense(operator: LaplaceBeltrami, n_pairs: int) -> tuple[FloatArray, FloatArray]:
    eigenvalues, vectors = eigh(
        operator.stiffness.toarray(),
        operator.mass.toarray(),
        subset_by_index=[0, n_pairs - 1],
        check_finite=False,
    )
    return eigenvalues, vectors


def _shift_invert(operator: LaplaceBeltrami, n_pairs: int) -> tuple[FloatArray, FloatArray]:
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
    eigenvalues, vectors = eigsh(
        stiffness,
        k=n_pairs + GUARD_PAIRS,
        M=mass,
        sigma=shift,
        OPinv=LinearOperator((n, n), matvec=factor.solve, dtype=np.float64),
        # ARPACK's own start is random; a fixed one makes the answer reproducible. It must have a part
        # in every eigenspace, so it must not be symmetric where the surface is.
        v0=np.random.default_rng(0).standard_normal(n),
    )
    order = np.argsort(eigenvalues)[:n_pairs]
    return eigenvalues[order], vectors[:, order]


def _checked(operator: LaplaceBeltrami, eigenvalues: FloatArray, vectors: FloatArray) -> Eigenpairs:
    area = operator.area
    if not eigenvalues[1] * area >= SMALLEST_GAP:
        raise SpectrumError(
            f"λ₁·area must be at least {SMALLEST_GAP:g}, got {eigenvalues[1] * area:.1e}: the surface is not "
            "connected, or hangs by a thread"
        )
    mapped = operator.mass @ vectors[:, 1:]  # (n, k − 1)
    residual = operator.stiffness @ vectors[:, 1:] - mapped * eigenvalues[1:]
    largest = float(
        (np.linalg.norm(residual, axis=0) / (eigenvalues[1:] * np.linalg.norm(mapped, axis=0))).max()
    )
    if not largest <= LARGEST_RESIDUAL:
        raise SpectrumError(f"relative residuals must stay below {LARGEST_RESIDUAL}, got {largest:.1e}")

    # λ₀ and φ₀ are known: say so, instead of keeping the solver's rounding.
    eigenvalues, vectors = eigenvalues.copy(), vectors.copy()
    eigenvalues[0] = 0.0
    vectors[:, 0] = 1 / np.sqrt(area)
    largest_entry = vectors[np.abs(vectors).argmax(axis=0), np.arange(vectors.shape[1])]
    return Eigenpairs(
        eigenvalues=eigenvalues,
        eigenvectors=vectors * np.sign(largest_entry),
        mass=operator.mass,
        largest_residual=largest,
    )
