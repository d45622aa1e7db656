"""Shift-invert block Lanczos iteration: the smallest eigenpairs of S φ = λ M φ.

T = (S − σM)⁻¹M has the eigenvectors φ, the eigenvalues θ = 1/(λ − σ), and is symmetric in the inner product
of M. With σ amid the wanted λ, their |θ| are the largest, and stand out more than with σ below all λ. The
iteration builds an M-orthonormal basis Q of the Krylov space of T, block by block. By the three-term
recurrence, each new block T Q_new is orthogonalised against the last two blocks, and when rounding errors
have accumulated, against the whole basis. The Rayleigh–Ritz method, the eigenpairs of QᵀMTQ, approximates the
largest |θ| first. It has found all λ below σ if as many θ are negative as S − σM has negative pivots.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, eigh
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from pcretrieve.errors import SpectrumError
from pcretrieve.spectral import blocks
from pcretrieve.spectral.blocks import BLOCK, CHUNK
from pcretrieve.spectral.elements import Index
from pcretrieve.values import FloatArray, LaplaceBeltrami

# Size of the basis: a multiple of the number of pairs, and a constant. Large enough that the iteration
# usually converges without a restart.
VECTORS_PER_PAIR = 3
SPARE_VECTORS = 12 * BLOCK

# Size of the basis at the first convergence test, which most surfaces pass: a test costs more than a block.
VECTORS_PER_PAIR_AT_FIRST_LOOK = 1.6
SPARE_VECTORS_AT_FIRST_LOOK = 6 * BLOCK

# Factor by which one block reduces the residuals. A convergence test takes a considerable part of the time of
# a block; the next test is therefore made when the residuals are expected to be below the tolerance.
FALL_PER_BLOCK = 4

# Largest number of vectors to which T is applied, in units of the size of the basis.
LONGEST_RUN = 5

# Largest loss of accuracy in one round of Gram–Schmidt orthogonalisation and Cholesky QR, as a factor: the
# ratio of the lengths of the vectors before and after, and the condition number of the block. Beyond it
# another round follows. Later blocks lose a factor of about 2; the first, and those after a restart, more.
LARGEST_LOSS = 5.0
MOST_ROUNDS = 6

# Largest estimated entry of QᵀMQ − I, beyond which a block is orthogonalised against the whole basis (partial
# reorthogonalisation). √ε would suffice for the eigenvalues, but would not save reorthogonalisations.
LARGEST_LOST = 3e-11

BlockMap = Callable[[FloatArray], FloatArray]  # a linear map of blocks


def basis_size(n_pairs: int) -> int:
    """The largest number of vectors in the basis, at which the iteration is restarted."""
    return VECTORS_PER_PAIR * n_pairs + SPARE_VECTORS


def block_krylov(
    operator: LaplaceBeltrami, n_pairs: int, *, shift: float, tolerance: float
) -> tuple[FloatArray, FloatArray, int]:
    """Block Lanczos iteration [1]_ with partial reorthogonalisation [2]_ and thick restart [3]_.

    operator: of at least `basis_size` + `BLOCK` rows.
    shift: σ, unit length⁻²; below zero, or among the first `n_pairs` eigenvalues.
    Returns eigenvalues, vectors, n_blocks: (n_pairs,) ascending; (n, n_pairs), M-orthonormal up to
        `LARGEST_LOST`; and the number of blocks.

    References
    ----------
    .. [1] Grimes, Lewis and Simon, "A shifted block Lanczos algorithm for solving sparse symmetric
       generalized eigenproblems", SIAM J. Matrix Anal. Appl. 15 (1994).
    .. [2] Simon, "The Lanczos algorithm with partial reorthogonalization", Math. Comp. 42 (1984); also Bai et
       al., "Templates for the solution of algebraic eigenvalue problems", SIAM 2000, equations (4.18) for the
       admissible loss of orthogonality and (4.19) for its recurrence.
    .. [3] Wu and Simon, "Thick-restart Lanczos method for large symmetric eigenvalue problems", SIAM J.
       Matrix Anal. Appl. 22 (2000).
    """
    factor = _factor(operator, n_pairs, shift)
    space = KrylovSpace(basis_size(n_pairs), len(factor.pivots))
    # A fixed start block, for reproducible results. It is random, because it must have a component in every
    # eigenspace, which vectors with the symmetry of a surface have not.
    random = np.random.default_rng(0)
    start = factor.solve(factor.mass(random.uniform(-1, 1, (len(factor.pivots), BLOCK))))
    # The last rows of QᵀMT block. The rows before them contain rounding errors and the effect of `lost` only.
    # They are set to zero, as they are for T projected onto an orthonormal basis of the same space [2]_.
    known = np.empty((0, BLOCK))
    block, mapped, left, drift = _orthonormal(
        start, space.vectors, factor.mass, known, known
    )
    norm = 0.0  # of T, about
    look_at = int(VECTORS_PER_PAIR_AT_FIRST_LOOK * n_pairs) + SPARE_VECTORS_AT_FIRST_LOOK
    for n_blocks in range(1, LONGEST_RUN * space.size // BLOCK + 1):
        space.append(block, drift)
        image = factor.solve(mapped)
        known = np.concatenate([known, mapped.T @ image])
        drift = space.project(known)
        norm = max(norm, float(np.linalg.norm(known)))
        drift += np.finfo(float).eps * norm * random.standard_normal(drift.shape)
        # T Q_new = Q_rows known + block left
        block, mapped, left, drift = _orthonormal(
            image, space.vectors, factor.mass, known, drift
        )
        known = left.T
        if space.width < look_at and not space.is_full:
            continue

        ritz = space.ritz(left)
        worst = ritz.largest_residual(n_pairs, shift, operator.area)
        if worst <= tolerance and (ritz.theta < 0).sum() == factor.n_negative:
            vectors = space.combined(ritz, n_pairs, block, factor.order)
            return 1 / ritz.theta[:n_pairs] + shift, vectors, n_blocks
        if space.is_full:
            space.restart(ritz, n_pairs)
            known = (ritz.outside * ritz.theta)[:, : space.width].T
            drift = ritz.mixing[:, : space.width].T @ drift
        look_at = space.width + BLOCK * math.ceil(
            np.log(worst / tolerance) / np.log(FALL_PER_BLOCK)
        )
    raise SpectrumError(
        f"residuals must fall below {tolerance:g}, got {worst:.1e} after {n_blocks} blocks: allow more"
    )


class Ritz(NamedTuple):
    """Approximate eigenpairs of T from a basis of `width` vectors, in the order of ascending λ.

    theta: (width,) eigenvalues θ of QᵀMTQ.
    mixing: (width, width) its eigenvectors, the components of φ along the basis.
    outside: (BLOCK, width) the components of T φ / θ along the block after the basis.
    """

    theta: FloatArray
    mixing: FloatArray
    outside: FloatArray

    def largest_residual(self, n_pairs: int, shift: float, area: float) -> float:
        """The largest residual of the first pairs, in units of λ + 1/area."""
        # λ + 1/area in units of |λ − σ|, at most 1.
        unit = np.minimum(1.0, np.abs(1 + self.theta[:n_pairs] * (shift + 1 / area)))
        return float((np.linalg.norm(self.outside[:, :n_pairs], axis=0) / unit).max())


class KrylovSpace:
    """An M-orthonormal basis Q of the space, the matrix QᵀMTQ, and an estimate of QᵀMQ − I.

    The first `width` of at most `size` vectors are in use. `basis` has one of n numbers in each row, and room
    for another block.
    """

    def __init__(self, size: int, n: int) -> None:
        self.size = size
        self.width = 0
        self.basis = np.empty((size + BLOCK, n))
        self.projected, self.lost = np.zeros((2, size, size))

    @property
    def vectors(self) -> FloatArray:
        """(width, n)."""
        return self.basis[: self.width]

    @property
    def is_full(self) -> bool:
        """Whether there is no room for another block and its projection."""
        return self.width + BLOCK > self.size

    def append(self, block: FloatArray, drift: FloatArray) -> None:
        """Add an M-orthonormal block; `drift` estimates its components (width, BLOCK) along the basis."""
        new = slice(self.width, self.width + BLOCK)
        self.basis[new] = block.T
        self.lost[: new.start, new] = drift
        self.lost[new, : new.start] = drift.T
        self.width = new.stop

    def project(self, known: FloatArray) -> FloatArray:
        """Enter the last rows of QᵀMT Q_new, those that are known, for the newest block.

        Returns an estimate (width, BLOCK) of QᵀM of what the basis leaves of T Q_new: the recurrence (4.19)
        of Bai et al., which follows from the symmetry of QᵀMTQ.
        """
        used = slice(0, self.width)
        new = slice(self.width - BLOCK, self.width)
        rows = slice(self.width - len(known), self.width)
        self.projected[rows, new] = known
        self.projected[new, rows] = known.T
        return (
            self.projected[used, used] @ self.lost[used, new]
            - self.lost[used, rows] @ known
        )

    def ritz(self, left: FloatArray) -> Ritz:
        """The eigenpairs of QᵀMTQ; `left` are the components of T Q_new along the block after the basis."""
        used = slice(0, self.width)
        theta, mixing = eigh(self.projected[used, used], driver="evd", check_finite=False)
        order = np.argsort(1 / theta)
        theta, mixing = theta[order], mixing[:, order]
        return Ritz(theta, mixing, left @ mixing[self.width - BLOCK :] / theta)

    def restart(self, ritz: Ritz, n_pairs: int) -> None:
        """Replace the basis, in place, by its combinations that approximate the first eigenvectors."""
        # About half of the sum, and a multiple of 4.
        kept = (n_pairs + self.size) // 8 * 4
        turn = ritz.mixing[:, :kept]
        for first in range(0, self.basis.shape[1], CHUNK):
            part = slice(first, first + CHUNK)
            self.basis[:kept, part] = turn.T @ self.basis[: self.width, part]
        self.lost[:kept, :kept] = turn.T @ self.lost[: self.width, : self.width] @ turn
        self.projected[:] = 0
        self.projected[:kept, :kept] = np.diag(ritz.theta[:kept])
        self.width = kept

    def combined(
        self, ritz: Ritz, n_pairs: int, block: FloatArray, order: Index
    ) -> FloatArray:
        """(n, n_pairs) eigenvectors, each row at its place in the operator.

        T φ / θ instead of φ: it is available, and more accurate by one iteration. It has components along the
        basis and along the block after it.
        """
        self.basis[self.width : self.width + BLOCK] = block.T
        outside = ritz.outside[:, :n_pairs]
        parts = np.concatenate(
            [ritz.mixing[:, :n_pairs], outside]
        )  # (width + BLOCK, n_pairs)
        parts -= parts @ (outside.T @ outside) / 2  # M-orthonormal again, to first order
        vectors = np.empty((self.basis.shape[1], n_pairs))
        for first in range(0, len(vectors), CHUNK):
            part = slice(first, first + CHUNK)
            vectors[order[part]] = self.basis[: len(parts), part].T @ parts
        return vectors


def _orthonormal(
    block: FloatArray,
    basis: FloatArray,
    mass: BlockMap,
    known: FloatArray,
    drift: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Orthogonalise an (n, BLOCK) block against a basis, in the inner product of M: block = Q known + X left.

    block: (n, BLOCK) float64, overwritten.
    basis: (width, n) float64, one vector in each row; Qᵀ are its last rows, as many as `known` has.
    known: (k, BLOCK) float64, the component of the block along Q.
    drift: (width, BLOCK) float64, estimate of the component of the block along the basis, apart from `known`.
    Returns X, M X, left, lost: X is M-orthonormal, and `lost`, (width, BLOCK), estimates its component along
        the basis, at most `LARGEST_LOST`.
    """
    # Subtracted first: a later projection would multiply it by the loss of orthogonality of the basis.
    blocks.subtract(basis[len(basis) - len(known) :], known, block)
    mapped = mass(block)
    left = np.eye(BLOCK)
    for n_rounds in range(MOST_ROUNDS):
        if n_rounds:
            error = blocks.components(basis, mapped)  # (width, BLOCK)
            blocks.subtract(basis, error, block)
            mapped = mass(block)
            drift = np.zeros_like(drift)
        gram = block.T @ mapped  # (BLOCK, BLOCK)
        if not np.isfinite(gram).all():
            raise SpectrumError(
                "the operator must be of a size to compute with, got overflow or NaN"
            )
        lower = np.linalg.cholesky(gram)
        inverse = np.linalg.inv(lower.T)
        lost = drift @ inverse  # (width, BLOCK)
        if np.abs(lost).max(initial=0) > LARGEST_LOST:
            continue
        blocks.times(block, inverse)
        blocks.times(mapped, inverse)
        left = lower.T @ left
        condition = np.linalg.norm(lower) * np.linalg.norm(inverse) / BLOCK
        loss = (
            np.sqrt(((error**2).sum(axis=0) / gram.diagonal()).max()) if n_rounds else 0.0
        )
        if max(condition, loss) <= LARGEST_LOSS:
            return block, mapped, left, lost
    raise LinAlgError("the space has no room for another block")


class Factor:
    """T, as M and LDLᵀ of S − σM without pivoting, by SuperLU, in an order of little fill-in.

    By Sylvester's law, D has as many negative entries as S − σM has negative eigenvalues.
    """

    def __init__(self, matrix: csc_array, mass: csc_array) -> None:
        # Minimum degree ordering of the symmetric pattern causes less fill-in than the default ordering. With
        # relaxed supernodes, regularly refined meshes may take ten times as long; narrow panels gain a tenth.
        factor = splu(
            matrix,
            "MMD_AT_PLUS_A",
            0.0,
            relax=1,
            panel_size=4,
            options={"SymmetricMode": True},
        )
        if not np.array_equal(factor.perm_r, factor.perm_c):
            raise LinAlgError("a pivot is zero")
        self.order: Index = np.argsort(factor.perm_r)
        self.pivots = factor.U.diagonal()
        self.lower = factor.L
        self.paired = blocks.paired(self.lower.indptr, self.lower.indices)
        self.n_negative = int((self.pivots < 0).sum())
        # In CSR format, since M is symmetric.
        self.ordered_mass = mass[self.order][:, self.order].T

    def mass(self, block: FloatArray) -> FloatArray:
        """(n, BLOCK) the product of M and a block (n, BLOCK), both with their rows in `order`."""
        mass = self.ordered_mass
        return blocks.product(mass.indptr, mass.indices, mass.data, block)

    def solve(self, right: FloatArray) -> FloatArray:
        """(n, BLOCK) the solution for right-hand sides (n, BLOCK), both with their rows in `order`."""
        solution = np.array(right, order="C")
        lower = self.lower
        blocks.substitute(
            solution, lower.indptr, lower.indices, lower.data, self.pivots, self.paired
        )
        return solution


def _factor(operator: LaplaceBeltrami, n_pairs: int, shift: float) -> Factor:
    factor = Factor(operator.stiffness - shift * operator.mass, operator.mass)
    if shift < 0 < factor.n_negative:
        raise SpectrumError(
            "S − σM must be positive definite for a σ below 0, got one that is not"
        )
    if factor.n_negative > n_pairs:
        raise SpectrumError(
            f"at most {n_pairs} eigenvalues must be below the shift, got {factor.n_negative}"
        )
    return factor
