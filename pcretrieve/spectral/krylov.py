"""Shift-invert block Krylov iteration: the lowest pairs of S φ = λ M φ.

T = (S − σM)⁻¹M has the eigenvectors of the pencil, the eigenvalues θ = 1/(λ − σ), and is symmetric in the
inner product of M. Blocks of it are made M-orthonormal to all that came before, and T projected on to them
gives θ, largest first, from the wanted end.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import LinAlgError, eigh, solve_triangular
from scipy.sparse import csc_array, csr_array

from pcretrieve.errors import NegativeEigenvalues, NonFiniteSpectrum, SpectrumNotConverged
from pcretrieve.types import FloatArray

__all__ = ["basis_size", "block_krylov"]

# A mesh of 20k vertices, 61 pairs, seconds on one busy core and relative error of the eigenvalues:
#
#     blocks of  4, 49 of them (196 vectors)      0.49  1e-13
#     blocks of  8, 26 of them (208 vectors)      0.49  5e-13    <- 20: 0.36, 1e-5; 24: 0.44, 3e-10; 32: 0.59
#     blocks of 16, 17 of them (272 vectors)      0.64  9e-13
#     blocks of 8, restarted at 157 vectors       0.51  1e-13
#     ARPACK on the same Cholesky factor          0.99  1e-13
#     ARPACK on SuperLU                           1.43
#     LaPy 1.7 (matrices included)                1.47
#     LOBPCG, 80 vectors, that factor's inverse   3.31  1e-12
#
# A block finds as many copies of an eigenvalue as it has columns. The symmetries of a body in space make five
# at most, exactly equal; but of the harmonics of a fine sphere, equal to some digits, blocks of 4 miss one of
# fifteen and blocks of 8 none. More than eight *exactly* equal ones would not be complete.
BLOCK = 8

# 61 pairs converge in about 230 vectors, 3 in 50, 250 in 640: with this much room nothing is restarted.
VECTORS_PER_PAIR = 3
SPARE_VECTORS = 12 * BLOCK

# Hardly a surface converges before the basis has this many.
VECTORS_PER_PAIR_AT_FIRST_LOOK = 2.2
SPARE_VECTORS_AT_FIRST_LOOK = 4 * BLOCK

# A look at the residuals costs as much as a third of a block, and a block makes them fall by a factor of
# three to five: the next look can wait until they may have arrived.
FALL_PER_BLOCK = 5

# Vectors that are multiplied by T before it is given up, in bases.
LONGEST_RUN = 5

# Gram–Schmidt and Cholesky QR lose as many digits as the vectors lose length, or their smallest combination
# does against the largest. Losing more than this, they are done again. It happens in the first blocks, which
# the smallest eigenvalues dominate, and after a restart; the others lose a factor of two.
LARGEST_LOSS = 5.0
MOST_ROUNDS = 6

# Columns of the basis that a restart combines at once: a copy of the whole would double the memory.
CHUNK = 4096


def basis_size(n_pairs: int) -> int:
    """Vectors that the basis may grow to before it is cut down."""
    return VECTORS_PER_PAIR * n_pairs + SPARE_VECTORS


def block_krylov(
    stiffness: csc_array, mass: csc_array, n_pairs: int, *, shift: float, tolerance: float
) -> tuple[FloatArray, FloatArray, int]:
    """Block Lanczos [1]_ with full reorthogonalisation and thick restart [2]_.

    Parameters
    ----------
    stiffness, mass : (n, n) sparse
        Symmetric, S − σM positive definite, n larger than `basis_size` and a block.
    n_pairs : int
    shift : float
        σ, below the smallest eigenvalue; unit length⁻².
    tolerance : float
        On ‖T φ − θ φ‖ / θ in the norm of M, of every wanted pair. Eigenvalues are better by its square.

    Returns
    -------
    eigenvalues : (n_pairs,) float64
        Ascending; unit length⁻².
    vectors : (n, n_pairs) float64
        M-orthonormal; unit length⁻¹.
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
    .. [2] Wu and Simon, "Thick-restart Lanczos method for large symmetric eigenvalue problems", SIAM J.
       Matrix Anal. Appl. 22 (2000).
    """
    n, size = mass.shape[0], basis_size(n_pairs)
    rows = csr_array(mass)
    solve = _cholesky(csr_array(stiffness - shift * mass))
    basis = np.empty((size, n))
    projected = np.zeros((size, size))  # QᵀMTQ
    # A fixed start makes the answer reproducible. It must have a part in every eigenspace, so it must not be
    # symmetric where the surface is.
    start = solve(rows @ np.random.default_rng(0).standard_normal((n, BLOCK)))
    known = np.empty((0, BLOCK))
    block, mapped, _, left = _orthonormal(start, basis[:0], rows, known)
    width, look_at = 0, int(VECTORS_PER_PAIR_AT_FIRST_LOOK * n_pairs) + SPARE_VECTORS_AT_FIRST_LOOK
    for n_blocks in range(1, LONGEST_RUN * size // BLOCK + 1):
        new = slice(width, width + BLOCK)
        width += BLOCK
        basis[new] = block.T
        image = solve(mapped)
        known = np.concatenate([known, mapped.T @ image])
        # T Q_new = Q along + block left
        block, mapped, along, left = _orthonormal(image, basis[:width], rows, known)
        known = left.T  # QᵀMT block of the last block in Q; of those before it, nothing but rounding
        projected[:width, new] = along
        projected[new, :width] = along.T
        full = width + BLOCK > size
        if width < look_at and not full:
            continue

        theta, mixing = eigh(projected[:width, :width], driver="evd", check_finite=False)
        theta, mixing = theta[::-1], mixing[:, ::-1]
        outside = left @ mixing[new] / theta  # (BLOCK, width): what T φ / θ has outside the basis
        worst = float(np.linalg.norm(outside[:, :n_pairs], axis=0).max())
        if worst <= tolerance:
            # T φ / θ instead of φ: it is known, and better by one iteration.
            vectors = np.ascontiguousarray(block) @ outside[:, :n_pairs]  # (n, n_pairs)
            vectors += (mixing[:, :n_pairs].T @ basis[:width]).T
            return 1 / theta[:n_pairs] + shift, vectors, n_blocks
        if full:
            width = (n_pairs + size) // 2
            for first in range(0, n, CHUNK):
                columns = slice(first, first + CHUNK)
                basis[:width, columns] = mixing[:, :width].T @ basis[: len(theta), columns]
            projected[:width, :width] = np.diag(theta[:width])
            known = (outside * theta)[:, :width].T
        look_at = width + BLOCK * int(max(1, np.log(worst / tolerance) / np.log(FALL_PER_BLOCK)))
    raise SpectrumNotConverged(
        f"residuals must fall below {tolerance:g}, got {worst:.1e} after {n_blocks} blocks: "
        "allow a larger tolerance, or try solver='arpack'"
    )


def _orthonormal(
    block: FloatArray, basis: FloatArray, mass: csr_array, known: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """An M-orthonormal X with block = Qᵀ along + X left; and M X, along, left.

    `known` is what is known of `along`: its last rows.
    """
    along, left = np.zeros((len(basis), BLOCK)), np.eye(BLOCK)
    # All of T X but rounding lies along the last two blocks. Taken off first, it cannot multiply what the
    # basis lacks in orthogonality: in one pass with the others, the error grows by half in every block.
    rows = slice(len(basis) - len(known), None)
    along[rows] = known
    block = block - basis[rows].T @ known  # (n, BLOCK)
    mapped = mass @ block
    for _ in range(MOST_ROUNDS):
        # Products with the block in rows take two thirds of the time of those with the block in columns.
        error = np.ascontiguousarray(mapped.T) @ basis.T  # (BLOCK, width)
        block -= (error @ basis).T
        mapped = mass @ block
        gram = block.T @ mapped  # (BLOCK, BLOCK)
        if not np.isfinite(gram).all():
            raise NonFiniteSpectrum("the operator must be of a size to compute with, got overflow or NaN")
        lower = np.linalg.cholesky(gram)
        inverse = solve_triangular(lower, np.eye(BLOCK), lower=True).T
        # In rows, as the basis takes it: to transpose by BLAS is faster than to copy.
        block, mapped = (inverse.T @ block.T).T, mapped @ inverse
        along += error.T @ left
        left = lower.T @ left
        condition = np.linalg.norm(lower) * np.linalg.norm(inverse) / BLOCK
        loss = np.sqrt(((error**2).sum(axis=1) / gram.diagonal()).max())
        if max(condition, loss) <= LARGEST_LOSS:
            return block, mapped, along, left
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
