"""Lower bounds of the distances between a query and the points of some blocks, compiled by numba."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pcretrieve.retrieval.blocks import Codes, Rows

__all__ = ["scan"]


# Contraction to fused multiply-add instructions makes rounding errors smaller, which the limit allows for.
@njit(cache=True, nogil=True, fastmath={"contract"})
def scan(
    codes: Codes,
    rows: Rows,
    blocks: NDArray[np.intp],
    offset: NDArray[np.float32],
    step: NDArray[np.float32],
    half: NDArray[np.float32],
    clip: np.float32,
    limit: np.float32,
    near: Rows,
    bounds: NDArray[np.float32],
) -> int:
    """Find the rows of some blocks that have a lower bound of at most a limit.

    Parameters
    ----------
    codes : (B, D, S) uint8
        As in `Blocks`.
    rows : (B, S) int32
        As in `Blocks`.
    blocks : (b,) intp
        The blocks.
    offset : (b, D) float32
        Coordinates of the centre of the first cell of each of these blocks, minus those of the query.
    step : (b, D) float32
        Lengths of the cells.
    half : (b, D) float32
        Half the lengths of the cells, enlarged by the rounding error.
    clip : float32
        Largest term of a sum of magnitudes; zero for a sum of squares.
    limit : float32
        The largest lower bound.
    near : (b * S,) int32
        Is overwritten by the rows that are found.
    bounds : (b * S,) float32
        Is overwritten by their lower bounds.

    Returns
    -------
    int
        Number of rows that are found.
    """
    n_axes, size = codes.shape[1:]
    zero = np.float32(0)
    total = np.empty(size, np.float32)
    found = 0
    for part in range(len(blocks)):
        block = blocks[part]
        total[:] = 0
        for axis in range(n_axes):
            cell = codes[block, axis]
            o, s, h = offset[part, axis], step[part, axis], half[part, axis]
            if clip == zero:
                for i in range(size):
                    apart = max(abs(np.float32(cell[i]) * s + o) - h, zero)
                    total[i] += apart * apart
            else:
                for i in range(size):
                    total[i] += min(max(abs(np.float32(cell[i]) * s + o) - h, zero), clip)
        for i in range(size):
            # The negation is true for a NaN too.
            if not (total[i] > limit) and rows[block, i] >= 0:
                near[found] = rows[block, i]
                bounds[found] = total[i]
                found += 1
    return found
