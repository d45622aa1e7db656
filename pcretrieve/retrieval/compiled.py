"""Lower bounds of the distances between a query and the points of some blocks, compiled by numba."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pcretrieve.retrieval.blocks import N_CELLS, Codes, Rows
from pcretrieve.values import FloatArray

__all__ = ["scan"]

# Number of rows that are left out together if the smallest of their sums is too large.
N_TOGETHER = 64

LARGEST_SUM = 2**16 - 1


@njit(cache=True, nogil=True)
def scan(
    codes: Codes,
    rows: Rows,
    low: FloatArray,
    high: FloatArray,
    step: FloatArray,
    blocks: NDArray[np.intp],
    query: FloatArray,
    half: float,
    clip: float,
    limit: np.float32,
    near: Rows,
    bounds: NDArray[np.float32],
) -> int:
    """Find the rows of some blocks that have a lower bound of at most a limit.

    The bounds are those of `pcretrieve.retrieval.interpreted.scan`.
    """
    if clip == 0:
        return _squares(codes, rows, low, step, blocks, query, half, limit, near, bounds)
    return _magnitudes(codes, rows, low, high, step, blocks, query, half, clip, limit, near, bounds)


# Contraction to fused multiply-add instructions makes rounding errors smaller, which the limit allows for.
@njit(cache=True, nogil=True, fastmath={"contract"})
def _squares(
    codes: Codes,
    rows: Rows,
    low: FloatArray,
    step: FloatArray,
    blocks: NDArray[np.intp],
    query: FloatArray,
    half: float,
    limit: np.float32,
    near: Rows,
    bounds: NDArray[np.float32],
) -> int:
    """The rows by sums of squares, in single precision."""
    n_axes, size = codes.shape[1:]
    zero = np.float32(0)
    total = np.empty(size, np.float32)
    found = 0
    for block in blocks:
        total[:] = 0
        for axis in range(n_axes):
            cell, length = codes[block, axis], step[block, axis]
            s, h = np.float32(length), np.float32(half * length)
            o = np.float32(low[block, axis] - query[axis] + length / 2)
            for i in range(size):
                apart = max(abs(np.float32(cell[i]) * s + o) - h, zero)
                total[i] += apart * apart
        for i in range(size):
            # The negation is true for a NaN too.
            if not (total[i] > limit) and rows[block, i] >= 0:
                near[found] = rows[block, i]
                bounds[found] = total[i]
                found += 1
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _magnitudes(
    codes: Codes,
    rows: Rows,
    low: FloatArray,
    high: FloatArray,
    step: FloatArray,
    blocks: NDArray[np.intp],
    query: FloatArray,
    half: float,
    clip: float,
    limit: np.float32,
    near: Rows,
    bounds: NDArray[np.float32],
) -> int:
    """The rows by sums of clipped magnitudes, in integers."""
    n_axes, size = codes.shape[1:]
    total = np.empty(size, np.uint16)
    cell, most = np.empty(n_axes, np.uint8), np.empty(n_axes, np.uint8)
    found = 0
    for block in blocks:
        length = step[block, 0]
        base = 0.0
        for axis in range(n_axes):
            inside = min(max(query[axis], low[block, axis]), high[block, axis])
            gap = min(abs(query[axis] - inside), clip)
            place = (inside - low[block, axis]) / length
            number = min(np.floor(place), N_CELLS - 1.0)
            n_cells = min(np.floor((clip - gap) / length), N_CELLS - 1.0)
            base += gap - length * min(half + abs(place - number - 0.5), n_cells)
            cell[axis], most[axis] = np.uint8(number), np.uint8(n_cells)
        # One more than the largest sum within the limit, for rounding. It is NaN if the range is not finite.
        largest = (limit - base) / length + 1
        if largest < 0:
            continue
        limit_of_sums = np.uint16(largest) if largest < LARGEST_SUM else np.uint16(LARGEST_SUM)
        total[:] = 0
        for axis in range(n_axes):
            _add_apart(codes[block, axis], cell[axis], most[axis], total)
        for first in range(0, size, N_TOGETHER):
            last = min(first + N_TOGETHER, size)
            least = np.uint16(LARGEST_SUM)
            for i in range(first, last):
                least = min(least, total[i])
            if least <= limit_of_sums:
                for i in range(first, last):
                    bound = np.float32(base + length * total[i])
                    if not (bound > limit) and rows[block, i] >= 0:
                        near[found] = rows[block, i]
                        bounds[found] = bound
                        found += 1
    return found


@njit(cache=True, nogil=True)
def _add_apart(codes: Codes, cell: np.uint8, most: np.uint8, total: NDArray[np.uint16]) -> None:
    """Add the numbers of cells from one cell to others (S,), each at most a number."""
    for i in range(total.size):
        # Numba computes with 64 bits; with eight, a register holds many numbers.
        apart = np.uint8(max(codes[i], cell) - min(codes[i], cell))
        total[i] += np.uint8(min(apart, most))
