"""Shift-invert block Krylov iteration: the lowest pairs of S φ = λ M φ.

T = (S − σM)⁻¹M has the eigenvectors of the pencil, the eigenvalues θ = 1/(λ − σ), and is symmetric in the
inner product of M. Blocks of it are made M-orthonormal to the two that came before, from time to time to all,
and T projected on to them gives θ, largest first, from the wanted end.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
from scipy.linalg import LinAlgError, eigh
from scipy.sparse import csc_array, csr_array

from pcretrieve.errors import NegativeEigenvalues, NonFiniteSpectrum, SpectrumNotConverged
from pcretrieve.types import FloatArray

__all__ = ["basis_size", "block_krylov"]

# A mesh of 20k vertices, 61 pairs, seconds on one core of a shared machine, relative error of the
# eigenvalues:
#
#     blocks of  4, 45 of them (180 vectors)      0.27  1e-13
#     blocks of  8, 24 of them (192 vectors)      0.28  1e-9     <- tolerance 1e-6: 27 of them, 0.30, 1e-13
#     blocks of 16, 15 of them (240 vectors)      0.34  8e-10
#     blocks of 8, each made orthogonal to all    0.32  1e-9
#     blocks of 8, restarted at 157 vectors       0.28  1e-9
#     ARPACK on the same Cholesky factor          0.98  1e-13
#     ARPACK on SuperLU                           1.13
#     LaPy 1.7 (matrices included)                1.09
#     LOBPCG, 80 vectors, that factor's inverse   3.06  2e-7
#
# A block finds as many copies of an eigenvalue as it has columns. The symmetries of a body in space make five
# at most, exactly equal; but of the harmonics of a fine sphere, equal to some digits, blocks of 4 miss one of
# fifteen and blocks of 8 none. More than eight *exactly* equal ones would not be complete.
BLOCK = 8

# To 1e-4, 61 pairs converge in about 200 vectors, 3 in 40, 250 in 580: with this much room nothing is
# restarted.
VECTORS_PER_PAIR = 3
SPARE_VECTORS = 12 * BLOCK

# Hardly a surface converges before the basis has this many.
VECTORS_PER_PAIR_AT_FIRST_LOOK = 2.3
SPARE_VECTORS_AT_FIRST_LOOK = 5 * BLOCK

# A look at the residuals costs as much as a third of a block or more, and a block makes them fall by a factor
# of three to five: the next look can wait until they should have arrived.
FALL_PER_BLOCK = 4

# Vectors that are multiplied by T before it is given up, in bases.
LONGEST_RUN = 5

# Gram–Schmidt and Cholesky QR lose as many digits as the vectors lose length, or their smallest combination
# does against the largest. Losing more than this, they are done again. It happens in the first blocks, which
# the smallest eigenvalues dominate, and after a restart; the others lose a factor of two.
LARGEST_LOSS = 5.0
MOST_ROUNDS = 6

# Largest entry of QᵀMQ − I. A block is taken to be orthogonal to all but the last two of the basis until it
# is thought to lose more than this, which is every other time: what is lost grows by hundreds in each block,
# so that √ε, all that eigenvalues need, saves nothing more. It is thought to be ten times what it is.
LARGEST_LOST = 3e-11

# Columns of the basis that a restart combines at once: a copy of the whole would double the memory.
CHUNK = 4096


def basis_size(n_pairs: int) -> int:
    """Vectors that the basis may grow to before it is cut down."""
    return VECTORS_PER_PAIR * n_pairs + SPARE_VECTORS


def block_krylov(
    stiffness: csc_array, mass: csc_array, n_pairs: int, *, shift: float, tolerance: float
) -> tuple[FloatArray, FloatArray, int]:
    """Block Lanczos [1]_ with partial reorthogonalisation [2]_ and thick restart [3]_.

    Parameters
    ----------
    stiffness, mass : (n, n) sparse
        Symmetric, S − σM positive definite, n larger than `basis_size` and a block.
    n_pairs : int
    shift : float
        σ, below the smallest eigenvalue; unit length⁻².
    tolerance : float
        On ‖T φ − θ φ‖ / θ in the norm of M, of every wanted pair. Eigenvalues are off by its square.

    Returns
    -------
    eigenvalues : (n_pairs,) float64
        Ascending; unit length⁻².
    vectors : (n, n_pairs) float64
        M-orthonormal to `LARGEST_LOST`; unit length⁻¹.
    n_blocks : int
        Blocks that T was applied to.

    Raises
    ------
    NegativeEigenvalues, NonFiniteSpectrum, SpectrumNotConverged
    LinAlgError
        If the space has no room for another block.

    References
    ----------
    .. [1] Grimes, Lewis and Simon, "A shifted block Lanczos algorithm for solving sparse symmetric
       generalized eigenproblems", SIAM J. Matrix Anal. Appl. 15 (1994).
    .. [2] Simon, "The Lanczos algorithm with partial reorthogonalization", Math. Comp. 42 (1984); for
       short in Bai et al., "Templates for the solution of algebraic eigenvalue problems", SIAM 2000,
       equations (4.18), what may be lost, and (4.19), how it grows.
    .. [3] Wu and Simon, "Thick-restart Lanczos method for large symmetric eigenvalue problems", SIAM J.
       Matrix Anal. Appl. 22 (2000).
    """
    n, size = mass.shape[0], basis_size(n_pairs)
    by_rows = mass.T  # M itself, which is symmetric, as CSR
    solve = _cholesky((stiffness - shift * mass).T)
    basis = np.empty((size + BLOCK, n))
    projected = np.zeros((size, size))  # QᵀMTQ
    lost = np.zeros((size, size))  # QᵀMQ − I, as it is thought to be
    rounding = np.finfo(float).eps / abs(shift)  # of T X: θ of a zero mode is the largest
    # A fixed start makes the answer reproducible. It must have a part in every eigenspace, so it must not be
    # symmetric where the surface is.
    random = np.random.default_rng(0)
    start = solve(by_rows @ random.standard_normal((n, BLOCK)))
    # Of QᵀMT block, the last rows. Before them is nothing but rounding and what `lost` makes of it, and that
    # is left out: T projected on to an orthonormal basis of the same space has none of it [2]_.
    known = np.empty((0, BLOCK))
    block, mapped, left, drift = _orthonormal(start, basis[:0], by_rows, known, known)
    width, look_at = 0, int(VECTORS_PER_PAIR_AT_FIRST_LOOK * n_pairs) + SPARE_VECTORS_AT_FIRST_LOOK
    for n_blocks in range(1, LONGEST_RUN * size // BLOCK + 1):
        new = slice(width, width + BLOCK)
        width += BLOCK
        basis[new] = block.T
        lost[: new.start, new] = drift
        lost[new, : new.start] = drift.T
        image = solve(mapped)
        known = np.concatenate([known, mapped.T @ image])
        rows = slice(width - len(known), width)
        projected[rows, new] = known
        projected[new, rows] = known.T
        # QᵀM of what will be left of the image: QᵀMTQ_new written in two ways, as T is symmetric.
        drift = projected[:width, :width] @ lost[:width, new] - lost[:width, rows] @ known
        drift += rounding * random.standard_normal(drift.shape)
        # T Q_new = Q_rows known + block left
        block, mapped, left, drift = _orthonormal(image, basis[:width], by_rows, known, drift)
        known = left.T
        full = width + BLOCK > size
        if width < look_at and not full:
            continue

        theta, mixing = eigh(projected[:width, :width], driver="evd", check_finite=False)
        theta, mixing = theta[::-1], mixing[:, ::-1]
        outside = left @ mixing[new] / theta  # (BLOCK, width): what T φ / θ has outside the basis
        worst = float(np.linalg.norm(outside[:, :n_pairs], axis=0).max())
        if worst <= tolerance:
            # T φ / θ instead of φ: it is known, and better by one iteration.
            basis[width : width + BLOCK] = block.T
            outside = outside[:, :n_pairs]
            parts = np.concatenate([mixing[:, :n_pairs], outside])  # (width + BLOCK, n_pairs)
            parts -= parts @ (outside.T @ outside) / 2  # M-orthonormal, as φ was
            vectors = np.empty((n, n_pairs))
            for part in _chunks(n):
                vectors[part] = basis[: len(parts), part].T @ parts
            return 1 / theta[:n_pairs] + shift, vectors, n_blocks
        if full:
            width = (n_pairs + size) // 2
            turn = mixing[:, :width]
            for part in _chunks(n):
                basis[:width, part] = turn.T @ basis[: len(turn), part]
            projected[:] = 0
            projected[:width, :width] = np.diag(theta[:width])
            known = (outside * theta)[:, :width].T
            lost[:width, :width] = turn.T @ lost[: len(turn), : len(turn)] @ turn
            drift = turn.T @ drift
        look_at = width + BLOCK * math.ceil(np.log(worst / tolerance) / np.log(FALL_PER_BLOCK))
    raise SpectrumNotConverged(
        f"residuals must fall below {tolerance:g}, got {worst:.1e} after {n_blocks} blocks: "
        "allow a larger tolerance, or try solver='arpack'"
    )


def _chunks(n: int) -> Iterator[slice]:
    """Of the rows of the basis' transpose: products of the whole would need as much room again."""
    for first in range(0, n, CHUNK):
        yield slice(first, first + CHUNK)


def _orthonormal(
    block: FloatArray, basis: FloatArray, mass: csr_array, known: FloatArray, drift: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """An M-orthonormal X with block = Qᵀ known + X left, Q the last rows of the basis; and M X, left, QᵀMX.

    `drift` is what the block is thought to have along the basis beyond `known`; the last of the results is
    what X is thought to have, no more than `LARGEST_LOST`.
    """
    # Taken off first, it cannot multiply what the basis lacks in orthogonality.
    block = block - basis[len(basis) - len(known) :].T @ known  # (n, BLOCK)
    mapped = mass @ block
    left = np.eye(BLOCK)
    for n_rounds in range(MOST_ROUNDS):
        if n_rounds:
            # Products with the block in rows take two thirds of the time of those with the block in columns.
            error = np.ascontiguousarray(mapped.T) @ basis.T  # (BLOCK, width)
            block -= (error @ basis).T
            mapped = mass @ block
            drift = np.zeros_like(drift)
        gram = block.T @ mapped  # (BLOCK, BLOCK)
        if not np.isfinite(gram).all():
            raise NonFiniteSpectrum("the operator must be of a size to compute with, got overflow or NaN")
        lower = np.linalg.cholesky(gram)
        inverse = np.linalg.inv(lower).T
        lost = drift @ inverse  # (width, BLOCK)
        if np.abs(lost).max(initial=0) > LARGEST_LOST:
            continue
        # In rows, as the basis takes it: to transpose by BLAS is faster than to copy.
        block, mapped = (inverse.T @ block.T).T, mapped @ inverse
        left = lower.T @ left
        condition = np.linalg.norm(lower) * np.linalg.norm(inverse) / BLOCK
        loss = np.sqrt(((error**2).sum(axis=1) / gram.diagonal()).max()) if n_rounds else 0.0
        if max(condition, loss) <= LARGEST_LOSS:
            return block, mapped, left, lost
    raise LinAlgError("the space has no room for another block")


def _cholesky(matrix: csr_array) -> Callable[[FloatArray], FloatArray]:
    """The inverse of a symmetric positive definite matrix, of which one triangle is read."""
    import cholespy  # its one door: it carries a CHOLMOD, and loads a GPU driver where it finds one

    try:
        solver = cholespy.CholeskySolverD(
            matrix.shape[0],
            matrix.indptr.astype(np.int32),
            matrix.indices.astype(np.int32),
            matrix.data,
            # As CSC it would be taken over, and freed, instead of copied.
            cholespy.MatrixType.CSR,
        )
    except ValueError as error:
        raise NegativeEigenvalues(
            f"S − σM must be positive definite for a σ below 0, got one that is not: {error}"
        ) from error

    def solve(right: FloatArray) -> FloatArray:
        solution = np.empty_like(right)
        solver.solve(right, solution)
        return solution

    return solve
