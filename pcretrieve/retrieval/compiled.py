"""Lower bounds of the distances between a query and the points of some blocks, compiled by numba."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pcretrieve.retrieval.blocks import Codes, Rows
from pcretrieve.types import FloatArray

__all__ = ["scan"]


# Contraction to fused multiply-add instructions makes rounding errors smaller, which the limit allows for.
@njit(cache=True, nogil=True, fastmath={"contract"})
def scan(
    codes: Codes,
    rows: Rows,
    low: FloatArray,
    step: FloatArray,
    blocks: NDArray[np.intp],
    query: FloatArray,
    half: float,
    clip: float,
    rounding: float,
    limit: np.float32,
    near: Rows,
    bounds: NDArray[np.float32],
) -> int:
    """Find the rows of some blocks that have a lower bound of at most a limit.

    The bounds of a sum of squares are the sums of the squared distances to the cells. For a sum of clipped
    magnitudes, min(|p − q|, c) ≥ min(x, c + h) − h, where x is the distance from q to the centre of the cell
    of p, and h half the length of the cell. The sum of h is the same for all points of a block.

    Parameters
    ----------
    codes : (B, D, S) uint8
        As in `Blocks`.
    rows : (B, S) int32
        As in `Blocks`.
    low, step : (B, D) float64
        As in `Blocks`.
    blocks : (b,) intp
        The blocks.
    query : (D,) float64
        Coordinates of the query.
    half : float
        Half the length of a cell relative to its length, enlarged by the rounding error.
    clip : float
        c, the largest term of a sum of magnitudes; zero for a sum of squares.
    rounding : float
        Factor of the sum of h that allows for rounding errors.
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
    for block in blocks:
        total[:] = 0 if clip == 0 else -rounding * half * step[block].sum()
        for axis in range(n_axes):
            cell, length = codes[block, axis], step[block, axis]
            s, h = np.float32(length), np.float32(half * length)
            o = np.float32(low[block, axis] - query[axis] + length / 2)
            if clip == 0:
                for i in range(size):
                    apart = max(abs(np.float32(cell[i]) * s + o) - h, zero)
                    total[i] += apart * apart
            else:
                most = np.float32(clip + half * length)
                for i in range(size):
                    total[i] += min(abs(np.float32(cell[i]) * s + o), most)
        for i in range(size):
            # The negation is true for a NaN too.
            if not (total[i] > limit) and rows[block, i] >= 0:
                near[found] = rows[block, i]
                bounds[found] = total[i]
                found += 1
    return found
