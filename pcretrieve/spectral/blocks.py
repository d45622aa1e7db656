"""Compiled products of blocks, the inner loops of the block Lanczos iteration.

A block is an (n, 8) array: eight vectors, so that one row is a vector of the processor. A basis is a
(width, n) array of one vector in each row, with a width that is a multiple of 4. In NumPy and SciPy:

    product(indptr, columns, entries, block)     csr_array((entries, columns, indptr)) @ block
    times(block, matrix)                         block[:] = block @ matrix
    components(basis, block)                     basis @ block
    subtract(basis, parts, block)                block -= basis.T @ parts
    paired(indptr, rows)                         L[:, j + 1] has entries below its diagonal where L[:, j] has
    substitute(block, ..., pivots, paired)       block[:] = solve(L @ diag(pivots) @ L.T, block)

BLAS takes twice as long for such narrow blocks, and SuperLU half as much again: see docs/decisions.md, BLOCK.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pcretrieve.spectral.elements import Index
from pcretrieve.values import FloatArray
from pcretrieve.values.compiled import compiled, inner

# Number of vectors in a block. An iteration finds at most as many copies of a multiple eigenvalue as the
# block has vectors. The symmetry groups of bodies in space have irreducible representations of dimension 5 at
# most, and thus eigenvalues of multiplicity 5 at most, except for accidental ones. For blocks of other sizes
# and other solvers see docs/decisions.md, BLOCK.
BLOCK = 8

# Number of columns of the basis with which a product is computed at once: so many rows of a block remain in
# the cache, and a copy of the basis would double the memory.
CHUNK = 512

# A row of a block.
Row = tuple[float, float, float, float, float, float, float, float]
NOTHING: Row = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@inner(fastmath={"contract"})
def _row(block: FloatArray, i: int) -> Row:
    """Row i of a block."""
    return (
        block[i, 0],
        block[i, 1],
        block[i, 2],
        block[i, 3],
        block[i, 4],
        block[i, 5],
        block[i, 6],
        block[i, 7],
    )


@inner(fastmath={"contract"})
def _put(block: FloatArray, i: int, row: Row) -> None:
    """Write row i of a block."""
    (
        block[i, 0],
        block[i, 1],
        block[i, 2],
        block[i, 3],
        block[i, 4],
        block[i, 5],
        block[i, 6],
        block[i, 7],
    ) = row


@inner(fastmath={"contract"})
def _plus(row: Row, factor: float, other: Row) -> Row:
    """The row plus a factor times another: one operation of the processor."""
    return (
        row[0] + factor * other[0],
        row[1] + factor * other[1],
        row[2] + factor * other[2],
        row[3] + factor * other[3],
        row[4] + factor * other[4],
        row[5] + factor * other[5],
        row[6] + factor * other[6],
        row[7] + factor * other[7],
    )


@compiled(fastmath={"contract"})
def product(
    indptr: Index, columns: Index, entries: FloatArray, block: FloatArray
) -> FloatArray:
    """The product of a CSR matrix and an (n, BLOCK) block."""
    product = np.empty_like(block)
    for i in range(len(block)):
        row = NOTHING
        for at in range(np.uint64(indptr[i]), np.uint64(indptr[i + 1])):
            row = _plus(row, entries[at], _row(block, np.uint64(columns[at])))
        _put(product, i, row)
    return product


@compiled(fastmath={"contract"})
def times(block: FloatArray, matrix: FloatArray) -> None:
    """Multiply an (n, BLOCK) block by a (BLOCK, BLOCK) matrix, in place."""
    for i in range(len(block)):
        row = NOTHING
        for k in range(BLOCK):
            row = _plus(row, block[i, k], _row(matrix, k))
        _put(block, i, row)


@compiled(fastmath={"contract"})
def components(basis: FloatArray, block: FloatArray) -> FloatArray:
    """(width, BLOCK): the product of a basis and a block. Four vectors of the basis read a row at once."""
    found = np.zeros((len(basis), BLOCK))
    for start in range(0, len(block), CHUNK):
        for k in range(0, len(basis), 4):
            first, second = _row(found, k), _row(found, k + 1)
            third, fourth = _row(found, k + 2), _row(found, k + 3)
            for i in range(start, min(start + CHUNK, len(block))):
                row = _row(block, i)
                first = _plus(first, basis[k, i], row)
                second = _plus(second, basis[k + 1, i], row)
                third = _plus(third, basis[k + 2, i], row)
                fourth = _plus(fourth, basis[k + 3, i], row)
            _put(found, k, first)
            _put(found, k + 1, second)
            _put(found, k + 2, third)
            _put(found, k + 3, fourth)
    return found


@compiled(fastmath={"contract"})
def subtract(basis: FloatArray, parts: FloatArray, block: FloatArray) -> None:
    """Subtract from a block, in place, the vectors whose components along the basis are (width, BLOCK)."""
    for start in range(0, len(block), CHUNK):
        for k in range(0, len(basis), 4):
            first, second = _row(parts, k), _row(parts, k + 1)
            third, fourth = _row(parts, k + 2), _row(parts, k + 3)
            for i in range(start, min(start + CHUNK, len(block))):
                row = _row(block, i)
                row = _plus(row, -basis[k, i], first)
                row = _plus(row, -basis[k + 1, i], second)
                row = _plus(row, -basis[k + 2, i], third)
                row = _plus(row, -basis[k + 3, i], fourth)
                _put(block, i, row)


@compiled()
def paired(indptr: Index, rows: Index) -> NDArray[np.bool_]:
    """(n + 1,) whether a column of L and the next are a pair: they have the same rows below the second.

    No column is in two pairs. The last value stays false, and is what index −1 reads.
    """
    paired = np.zeros(len(indptr), dtype=np.bool_)
    for j in range(len(indptr) - 2):
        first, last = indptr[j] + 1, indptr[j + 1]
        if not paired[j - 1] and indptr[j + 2] - last == last - first:
            paired[j] = (rows[first:last] == rows[last : indptr[j + 2]]).all()
    return paired


@compiled(error_model="numpy", fastmath={"contract"})
def substitute(
    block: FloatArray,
    indptr: Index,
    rows: Index,
    lower: FloatArray,
    pivots: FloatArray,
    paired: NDArray[np.bool_],
) -> None:
    """Solve L D Lᵀ X = B in place: B is the block, and columns of L begin with its diagonal.

    A pair of columns reads each row of the block once.
    """
    _forward(block, indptr, rows, lower, paired)
    _backward(block, indptr, rows, lower, pivots, paired)


# Indices without a sign need no test for negative ones. In a pair, the entries of both columns for one row
# lie as far apart as the first column is long below its diagonal.


@inner(error_model="numpy", fastmath={"contract"})
def _forward(
    block: FloatArray,
    indptr: Index,
    rows: Index,
    lower: FloatArray,
    paired: NDArray[np.bool_],
) -> None:
    """Solve L Y = B in place, from the first row to the last."""
    column = 0
    while column < len(indptr) - 1:
        at, end = np.uint64(indptr[column] + 1), np.uint64(indptr[column + 1])
        known = _row(block, column)
        if paired[column]:
            following = _plus(_row(block, column + 1), -lower[at], known)
            _put(block, column + 1, following)
            behind = end - at
            for k in range(at + np.uint64(1), end):
                i = np.uint64(rows[k])
                row = _plus(_row(block, i), -lower[k], known)
                _put(block, i, _plus(row, -lower[k + behind], following))
            column += 2
        else:
            for k in range(at, end):
                i = np.uint64(rows[k])
                _put(block, i, _plus(_row(block, i), -lower[k], known))
            column += 1


@inner(error_model="numpy", fastmath={"contract"})
def _backward(
    block: FloatArray,
    indptr: Index,
    rows: Index,
    lower: FloatArray,
    pivots: FloatArray,
    paired: NDArray[np.bool_],
) -> None:
    """Solve D Lᵀ X = Y in place, from the last row to the first."""
    column = len(pivots)
    while column > 0:
        if paired[column - 2]:
            column -= 2
            at, end = np.uint64(indptr[column] + 1), np.uint64(indptr[column + 1])
            sought = _plus(NOTHING, 1 / pivots[column], _row(block, column))
            following = _plus(NOTHING, 1 / pivots[column + 1], _row(block, column + 1))
            behind = end - at
            for k in range(at + np.uint64(1), end):
                row = _row(block, np.uint64(rows[k]))
                sought = _plus(sought, -lower[k], row)
                following = _plus(following, -lower[k + behind], row)
            _put(block, column + 1, following)
            _put(block, column, _plus(sought, -lower[at], following))
        else:
            column -= 1
            sought = _plus(NOTHING, 1 / pivots[column], _row(block, column))
            for k in range(np.uint64(indptr[column] + 1), np.uint64(indptr[column + 1])):
                sought = _plus(sought, -lower[k], _row(block, np.uint64(rows[k])))
            _put(block, column, sought)
