"""The scan of the cells of `pcretrieve.retrieval.bounds`, compiled by numba, which takes .5 s to load."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pcretrieve.values import FloatArray


# Contraction to fused multiply-add instructions makes rounding errors smaller, which the limit allows for.
@njit(cache=True, nogil=True, fastmath={"contract"})
def scan(
    codes: NDArray[np.uint8],
    rows: NDArray[np.int32],
    middle: NDArray[np.float32],
    step: NDArray[np.float32],
    reach: FloatArray,
    blocks: NDArray[np.intp],
    limit: np.float32,
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """The rows of some blocks whose squared distance to their cells is at most a limit, and these squares.

    The distance to a cell is at least that to its middle, less half its diagonal.

    codes, rows: (B, D, S) and (B, S), as in `LowerBounds`.
    middle: (B, D), the middles of the first cells of each block, relative to the query.
    step: (B, D), lengths of the cells.
    reach: (B,), halves of the diagonals of the cells.
    blocks: (b,), the blocks to scan.
    """
    n_axes, size = codes.shape[1:]
    near = np.empty(len(blocks) * size, np.int32)
    bounds = np.empty(len(near), np.float32)
    total = np.empty(size, np.float32)
    found = 0
    for block in blocks:
        total[:] = 0
        for axis in range(n_axes):
            cell, s, o = codes[block, axis], step[block, axis], middle[block, axis]
            for i in range(size):
                along = np.float32(cell[i]) * s + o
                total[i] += along * along
        most = np.float32((math.sqrt(limit) + reach[block]) ** 2)
        for i in range(size):
            # The negation is true for a NaN too.
            if not (total[i] > most) and rows[block, i] >= 0:
                near[found] = rows[block, i]
                bounds[found] = max(math.sqrt(total[i]) - reach[block], 0.0) ** 2
                found += 1
    return near[:found], bounds[:found]
