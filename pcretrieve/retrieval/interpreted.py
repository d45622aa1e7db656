"""Lower bounds of the distances between a query and the points of some blocks, without compiled code."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pcretrieve.retrieval.blocks import N_CELLS, NO_ROW, Codes, Rows
from pcretrieve.values import FloatArray

__all__ = ["scan"]

# Number of blocks whose bounds are computed together: their arrays fit the second-level cache.
N_TOGETHER = 32


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

    The bounds of a sum of squares are the sums of the squared distances to the cells.

    For a sum of clipped magnitudes, let q' be the nearest coordinate to q in the range of the block, and
    g = min(|q − q'|, c). Then min(|p − q|, c) ≥ g + min(|p − q'|, c − g). Let the length of the cells be the
    unit, j and i the numbers of the cells of p and q', and r the distance of q' from the centre of its cell.
    Then |p − q'| ≥ |j − i| − (1/2 + r), and therefore, for any m ≤ c − g,

        min(|p − q|, c) ≥ g + min(|j − i|, m) − min(1/2 + r, m).

    For whole numbers m, the sum of min(|j − i|, m) is one of integers, of eight bits each. The sum of the
    other terms is the same for all points of a block.

    codes: (B, D, S) uint8, as in `Blocks`.
    rows: (B, S) int32, as in `Blocks`.
    low, high, step: (B, D) float64, as in `Blocks`; for a sum of magnitudes, the cells of a block have one
        length.
    blocks: (b,) intp, the blocks.
    query: (D,) float64, coordinates of the query.
    near: (b * S,) int32, is overwritten by the rows that are found.
    bounds: (b * S,) float32, is overwritten by their lower bounds.
    """
    found = 0
    for first in range(0, len(blocks), N_TOGETHER):
        part = blocks[first : first + N_TOGETHER]
        with np.errstate(over="ignore", invalid="ignore"):
            if clip:
                total = _magnitudes(codes[part], low[part], high[part], step[part, :1], query, half, clip)
            else:
                total = _squares(codes[part], low[part], step[part], query, half)
        within = ~(total > limit) & (rows[part] != NO_ROW)
        some = slice(found, found + np.count_nonzero(within))
        near[some], bounds[some] = rows[part][within], total[within]
        found = some.stop
    return found


def _squares(
    codes: Codes, low: FloatArray, step: FloatArray, query: FloatArray, half: float
) -> NDArray[np.float32]:
    """(b, S) sums of the squared distances to the cells."""
    offset = (low - query + step / 2).astype(np.float32)[:, :, np.newaxis]
    ends = (half * step).astype(np.float32)[:, :, np.newaxis]
    single = step.astype(np.float32)[:, :, np.newaxis]
    total = np.zeros((len(codes), codes.shape[2]), np.float32)
    for axis in range(codes.shape[1]):
        apart = codes[:, axis] * single[:, axis]
        apart += offset[:, axis]
        np.abs(apart, out=apart)
        total += np.square(np.maximum(apart - ends[:, axis], 0, out=apart), out=apart)
    return total


def _magnitudes(
    codes: Codes,
    low: FloatArray,
    high: FloatArray,
    length: FloatArray,
    query: FloatArray,
    half: float,
    clip: float,
) -> NDArray[np.float32]:
    """(b, S) sums of the clipped magnitudes of the distances to the cells, which have one length (b, 1)."""
    inside = np.clip(query, low, high)
    gap = np.minimum(np.abs(query - inside), clip)
    place = (inside - low) / length
    number = np.minimum(np.floor(place), N_CELLS - 1)
    n_cells = np.minimum(np.floor((clip - gap) / length), N_CELLS - 1)
    base = (gap - length * np.minimum(half + np.abs(place - number - 0.5), n_cells)).sum(axis=1)
    # Where the range of a block is not finite, the sum is NaN, whatever its integers are.
    cell, most = (np.nan_to_num(each).astype(np.uint8)[:, :, np.newaxis] for each in (number, n_cells))
    count = np.zeros((len(codes), codes.shape[2]), np.uint16)
    for axis in range(codes.shape[1]):
        apart = np.maximum(codes[:, axis], cell[:, axis]) - np.minimum(codes[:, axis], cell[:, axis])
        count += np.minimum(apart, most[:, axis])
    total: NDArray[np.float32] = (base[:, np.newaxis] + length * count).astype(np.float32)
    return total
