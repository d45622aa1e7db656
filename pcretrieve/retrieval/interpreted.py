"""Lower bounds of the distances between a query and the points of some blocks, without compiled code."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pcretrieve.retrieval.blocks import NO_ROW, Codes, Rows

__all__ = ["scan"]

# Number of blocks whose bounds are computed together: their arrays fit the second-level cache.
N_TOGETHER = 32


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
    """Find the rows of some blocks that have a lower bound of at most a limit, as `compiled.scan` does.

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
    found = 0
    for start in range(0, len(blocks), N_TOGETHER):
        part = slice(start, start + N_TOGETHER)
        members = rows[blocks[part]]  # (b, S)
        total = np.zeros(members.shape, np.float32)
        with np.errstate(over="ignore", invalid="ignore"):
            for axis in range(codes.shape[1]):
                apart = codes[blocks[part], axis] * step[part, axis, np.newaxis]
                apart += offset[part, axis, np.newaxis]
                np.abs(apart, out=apart)
                apart -= half[part, axis, np.newaxis]
                np.maximum(apart, 0, out=apart)
                total += np.minimum(apart, clip, out=apart) if clip else np.square(apart, out=apart)
        within = ~(total > limit) & (members != NO_ROW)
        some = slice(found, found + np.count_nonzero(within))
        near[some], bounds[some] = members[within], total[within]
        found = some.stop
    return found
