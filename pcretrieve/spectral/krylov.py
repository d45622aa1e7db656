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
from functools import partial

import numpy as np
from numba import config, njit
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, eigh
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from pcretrieve.errors import SpectrumError
from pcretrieve.spectral.elements import Index
from pcretrieve.values import FloatArray, LaplaceBeltrami

# Number of vectors in a block. An iteration finds at most as many copies of a multiple eigenvalue as the
# block has vectors. The symmetry groups of bodies in space have irreducible representations of dimension 5 at
# most, and thus eigenvalues of multiplicity 5 at most, except for accidental ones. For blocks of other sizes
# and other solvers see docs/decisions.md, BLOCK.
BLOCK = 8

# Rows of eight numbers are vectors of the processor, if numba lets LLVM combine equal operations. The setting
# is one of the process; operations are combined, not reordered, so that no result changes.
config.SLP_VECTORIZE = 1  # type: ignore[attr-defined]

# An untouched block, freed at once: glibc then keeps up to 64 MiB of free memory at the end of the heap,
# twice the largest block that it has mapped and freed (mallopt(3), M_MMAP_THRESHOLD). Else each surface takes
# it anew from the system, with thousands of page faults: 15 % of the time of 5,000 vertices, 6 % of a scan.
np.empty((32 << 20) - (64 << 10), dtype=np.uint8)

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

# Number of columns of the basis with which a product is computed at once: so many rows of a block remain in
# the cache, and a copy of the basis would double the memory.
CHUNK = 512

# A row of a block of zeros, and a linear map of blocks.
NOTHING: tuple[float, ...] = (0.0,) * BLOCK
BlockMap = Callable[[FloatArray], FloatArray]


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
    n, size = operator.mass.shape[0], basis_size(n_pairs)
    factor = _factor(operator, n_pairs, shift)
    # In the order of the factor, as the iteration is, and in CSR format, since M is symmetric.
    ordered = operator.mass[factor.order][:, factor.order].T
    mass = partial(_product, ordered.indptr, ordered.indices, ordered.data)
    basis = np.empty((size + BLOCK, n))
    projected, lost = np.zeros((2, size, size))  # QᵀMTQ, and an estimate of QᵀMQ − I
    # A fixed start block, for reproducible results. It is random, because it must have a component in every
    # eigenspace, which vectors with the symmetry of a surface have not.
    random = np.random.default_rng(0)
    start = factor.solve(mass(random.uniform(-1, 1, (n, BLOCK))))
    # The last rows of QᵀMT block. The rows before them contain rounding errors and the effect of `lost` only.
    # They are set to zero, as they are for T projected onto an orthonormal basis of the same space [2]_.
    known = np.empty((0, BLOCK))
    block, mapped, left, drift = _orthonormal(start, basis[:0], mass, known, known)
    norm, width, look_at = (
        0.0,
        0,
        int(VECTORS_PER_PAIR_AT_FIRST_LOOK * n_pairs) + SPARE_VECTORS_AT_FIRST_LOOK,
    )
    for n_blocks in range(1, LONGEST_RUN * size // BLOCK + 1):
        new = slice(width, width + BLOCK)
        width += BLOCK
        basis[new] = block.T
        lost[: new.start, new] = drift
        lost[new, : new.start] = drift.T
        image = factor.solve(mapped)
        known = np.concatenate([known, mapped.T @ image])
        rows = slice(width - len(known), width)
        projected[rows, new] = known
        projected[new, rows] = known.T
        # Estimate of QᵀM of the remainder of the image: the recurrence (4.19) of [2]_, from the symmetry of
        # QᵀMTQ.
        drift = projected[:width, :width] @ lost[:width, new] - lost[:width, rows] @ known
        norm = max(norm, float(np.linalg.norm(known)))  # of T, about
        drift += np.finfo(float).eps * norm * random.standard_normal(drift.shape)
        # T Q_new = Q_rows known + block left
        block, mapped, left, drift = _orthonormal(image, basis[:width], mass, known, drift)
        known = left.T
        full = width + BLOCK > size
        if width < look_at and not full:
            continue

        theta, mixing = _ritz(projected[:width, :width])
        outside = (
            left @ mixing[new] / theta
        )  # (BLOCK, width): the component of T φ / θ outside the basis
        unit = _unit(theta[:n_pairs], shift, operator.area)
        worst = float((np.linalg.norm(outside[:, :n_pairs], axis=0) / unit).max())
        if worst <= tolerance and (theta < 0).sum() == factor.n_negative:
            # T φ / θ instead of φ: it is available, and more accurate by one iteration.
            basis[width : width + BLOCK] = block.T
            vectors = _combined(basis, mixing[:, :n_pairs], outside[:, :n_pairs], factor.order)
            return 1 / theta[:n_pairs] + shift, vectors, n_blocks
        if full:
            width = (n_pairs + size) // 8 * 4  # about half of the sum, and a multiple of 4
            turn = mixing[:, :width]
            _turn(basis, lost, turn)
            projected[:] = 0
            projected[:width, :width] = np.diag(theta[:width])
            known = (outside * theta)[:, :width].T
            drift = turn.T @ drift
        look_at = width + BLOCK * math.ceil(np.log(worst / tolerance) / np.log(FALL_PER_BLOCK))
    raise SpectrumError(
        f"residuals must fall below {tolerance:g}, got {worst:.1e} after {n_blocks} blocks: allow more"
    )


def _ritz(projected: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Eigenvalues θ in the order of ascending λ, and eigenvectors."""
    theta, mixing = eigh(projected, driver="evd", check_finite=False)
    order = np.argsort(1 / theta)
    return theta[order], mixing[:, order]


def _unit(theta: FloatArray, shift: float, area: float) -> FloatArray:
    """λ + 1/area in units of |λ − σ|, at most 1: what residuals are measured in."""
    return np.minimum(1.0, np.abs(1 + theta * (shift + 1 / area)))


def _turn(basis: FloatArray, lost: FloatArray, turn: FloatArray) -> None:
    """Replace the first vectors of the basis by their combinations, the columns of `turn`, in place."""
    old, new = turn.shape
    for first in range(0, basis.shape[1], CHUNK):
        part = slice(first, first + CHUNK)
        basis[:new, part] = turn.T @ basis[:old, part]
    lost[:new, :new] = turn.T @ lost[:old, :old] @ turn


def _combined(
    basis: FloatArray, mixing: FloatArray, outside: FloatArray, order: Index
) -> FloatArray:
    """The (n, n_pairs) eigenvectors: combinations of the basis, and of the block after it, at their rows."""
    parts = np.concatenate([mixing, outside])  # (width + BLOCK, n_pairs)
    parts -= parts @ (outside.T @ outside) / 2  # M-orthonormal again, to first order
    vectors = np.empty((basis.shape[1], parts.shape[1]))
    for first in range(0, len(vectors), CHUNK):
        part = slice(first, first + CHUNK)
        vectors[order[part]] = basis[: len(parts), part].T @ parts
    return vectors


def _orthonormal(
    block: FloatArray, basis: FloatArray, mass: BlockMap, known: FloatArray, drift: FloatArray
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
    _subtract(basis[len(basis) - len(known) :], known, block)
    mapped = mass(block)
    left = np.eye(BLOCK)
    for n_rounds in range(MOST_ROUNDS):
        if n_rounds:
            error = _components(basis, mapped)  # (width, BLOCK)
            _subtract(basis, error, block)
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
        _times(block, inverse)
        _times(mapped, inverse)
        left = lower.T @ left
        condition = np.linalg.norm(lower) * np.linalg.norm(inverse) / BLOCK
        loss = np.sqrt(((error**2).sum(axis=0) / gram.diagonal()).max()) if n_rounds else 0.0
        if max(condition, loss) <= LARGEST_LOSS:
            return block, mapped, left, lost
    raise LinAlgError("the space has no room for another block")


@njit(cache=True, fastmath={"contract"})
def _row(x: FloatArray, i: int) -> tuple[float, ...]:
    return x[i, 0], x[i, 1], x[i, 2], x[i, 3], x[i, 4], x[i, 5], x[i, 6], x[i, 7]


@njit(cache=True, fastmath={"contract"})
def _put(x: FloatArray, i: int, row: tuple[float, ...]) -> None:
    x[i, 0], x[i, 1], x[i, 2], x[i, 3], x[i, 4], x[i, 5], x[i, 6], x[i, 7] = row


@njit(cache=True, fastmath={"contract"})
def _plus(x: tuple[float, ...], a: float, y: tuple[float, ...]) -> tuple[float, ...]:
    (p, q, r, s, t, u, v, w), (e, f, g, h, i, j, k, m) = x, y
    return p + a * e, q + a * f, r + a * g, s + a * h, t + a * i, u + a * j, v + a * k, w + a * m


@njit(cache=True, fastmath={"contract"})
def _product(indptr: Index, columns: Index, entries: FloatArray, block: FloatArray) -> FloatArray:
    """The product of a CSR matrix and an (n, BLOCK) block."""
    product = np.empty_like(block)
    for i in range(len(block)):
        row = NOTHING
        for at in range(np.uint64(indptr[i]), np.uint64(indptr[i + 1])):
            row = _plus(row, entries[at], _row(block, np.uint64(columns[at])))
        _put(product, i, row)
    return product


@njit(cache=True, fastmath={"contract"})
def _times(block: FloatArray, matrix: FloatArray) -> None:
    """Multiply an (n, BLOCK) block by a (BLOCK, BLOCK) matrix, in place."""
    for i in range(len(block)):
        row = NOTHING
        for k in range(BLOCK):
            row = _plus(row, block[i, k], _row(matrix, k))
        _put(block, i, row)


@njit(cache=True, fastmath={"contract"})
def _components(basis: FloatArray, block: FloatArray) -> FloatArray:
    """The product of a (width, n) basis, with a width that is a multiple of 4, and an (n, BLOCK) block."""
    components = np.zeros((len(basis), BLOCK))
    for first in range(0, len(block), CHUNK):
        for k in range(0, len(basis), 4):
            p, q = _row(components, k), _row(components, k + 1)
            r, s = _row(components, k + 2), _row(components, k + 3)
            for i in range(first, min(first + CHUNK, len(block))):
                row = _row(block, i)
                p, q = _plus(p, basis[k, i], row), _plus(q, basis[k + 1, i], row)
                r, s = _plus(r, basis[k + 2, i], row), _plus(s, basis[k + 3, i], row)
            _put(components, k, p)
            _put(components, k + 1, q)
            _put(components, k + 2, r)
            _put(components, k + 3, s)
    return components


@njit(cache=True, fastmath={"contract"})
def _subtract(basis: FloatArray, components: FloatArray, block: FloatArray) -> None:
    """Subtract what (width, BLOCK) components stand for from an (n, BLOCK) block, in place."""
    for first in range(0, len(block), CHUNK):
        for k in range(0, len(basis), 4):
            p, q = _row(components, k), _row(components, k + 1)
            r, s = _row(components, k + 2), _row(components, k + 3)
            for i in range(first, min(first + CHUNK, len(block))):
                row = _plus(_plus(_row(block, i), -basis[k, i], p), -basis[k + 1, i], q)
                _put(block, i, _plus(_plus(row, -basis[k + 2, i], r), -basis[k + 3, i], s))


@njit(cache=True)
def _paired(indptr: Index, rows: Index) -> NDArray[np.bool_]:
    """(n + 1,) whether a column of L and the next have the same rows, and are a pair: no column is in two."""
    paired = np.zeros(
        len(indptr), dtype=np.bool_
    )  # the last one stays false, and is what index −1 reads
    for j in range(len(indptr) - 2):
        first, last = indptr[j] + 1, indptr[j + 1]
        if not paired[j - 1] and indptr[j + 2] - last == last - first:
            paired[j] = (rows[first:last] == rows[last : indptr[j + 2]]).all()
    return paired


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _substitute(
    x: FloatArray,
    indptr: Index,
    rows: Index,
    lower: FloatArray,
    pivots: FloatArray,
    paired: NDArray[np.bool_],
) -> None:
    """Solve L D Lᵀ X = B in place, B of BLOCK columns; columns of L begin with its diagonal.

    A pair of columns reads each row of X once. Indices without a sign need no test for negative ones.
    """
    j = 0
    while j < len(pivots):
        at, end = np.uint64(indptr[j] + 1), np.uint64(indptr[j + 1])
        y = _row(x, j)
        if paired[j]:
            z = _plus(_row(x, j + 1), -lower[at], y)
            _put(x, j + 1, z)
            ahead = end - at
            for k in range(at + np.uint64(1), end):
                i = np.uint64(rows[k])
                _put(x, i, _plus(_plus(_row(x, i), -lower[k], y), -lower[k + ahead], z))
            j += 2
        else:
            for k in range(at, end):
                i = np.uint64(rows[k])
                _put(x, i, _plus(_row(x, i), -lower[k], y))
            j += 1
    while j > 0:
        if paired[j - 2]:
            j -= 2
            at, end = np.uint64(indptr[j] + 1), np.uint64(indptr[j + 1])
            y = _plus(NOTHING, 1 / pivots[j], _row(x, j))
            z = _plus(NOTHING, 1 / pivots[j + 1], _row(x, j + 1))
            ahead = end - at
            for k in range(at + np.uint64(1), end):
                row = _row(x, np.uint64(rows[k]))
                y, z = _plus(y, -lower[k], row), _plus(z, -lower[k + ahead], row)
            _put(x, j + 1, z)
            _put(x, j, _plus(y, -lower[at], z))
        else:
            j -= 1
            y = _plus(NOTHING, 1 / pivots[j], _row(x, j))
            for k in range(np.uint64(indptr[j] + 1), np.uint64(indptr[j + 1])):
                y = _plus(y, -lower[k], _row(x, np.uint64(rows[k])))
            _put(x, j, y)


class Factor:
    """LDLᵀ of a symmetric matrix without pivoting, by SuperLU, in an order of little fill-in.

    By Sylvester's law, D has as many negative entries as the matrix has negative eigenvalues.
    """

    def __init__(self, matrix: csc_array) -> None:
        # Minimum degree ordering of the symmetric pattern causes less fill-in than the default ordering. With
        # relaxed supernodes, regularly refined meshes may take ten times as long; narrow panels gain a tenth.
        factor = splu(
            matrix, "MMD_AT_PLUS_A", 0.0, relax=1, panel_size=4, options={"SymmetricMode": True}
        )
        if not np.array_equal(factor.perm_r, factor.perm_c):
            raise LinAlgError("a pivot is zero")
        self.order, self.pivots, self.lower = (
            np.argsort(factor.perm_r),
            factor.U.diagonal(),
            factor.L,
        )
        self.paired = _paired(self.lower.indptr, self.lower.indices)
        self.n_negative = int((self.pivots < 0).sum())

    def solve(self, right: FloatArray) -> FloatArray:
        """(n, BLOCK) the solution for right-hand sides (n, BLOCK), both with their rows in `order`."""
        solution = np.array(right, order="C")
        _substitute(
            solution,
            self.lower.indptr,
            self.lower.indices,
            self.lower.data,
            self.pivots,
            self.paired,
        )
        return solution


def _factor(operator: LaplaceBeltrami, n_pairs: int, shift: float) -> Factor:
    factor = Factor(operator.stiffness - shift * operator.mass)
    if shift < 0 < factor.n_negative:
        raise SpectrumError("S − σM must be positive definite for a σ below 0, got one that is not")
    if factor.n_negative > n_pairs:
        raise SpectrumError(
            f"at most {n_pairs} eigenvalues must be below the shift, got {factor.n_negative}"
        )
    return factor
