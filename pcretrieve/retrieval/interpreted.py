"""Lower bounds of the distances between a query and the points of some blocks, without compiled code."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pcretrieve.retrieval.blocks import NO_ROW, Codes, Rows
from pcretrieve.types import FloatArray

__all__ = ["scan"]

# Number of blocks whose bounds are computed together: their arrays fit the second-level cache.
N_TOGETHER = 32


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
    """Find the rows of some blocks that have a lower bound of at most a limit, as `compiled.scan` does.

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
    found = 0
    for first in range(0, len(blocks), N_TOGETHER):
        part = blocks[first : first + N_TOGETHER]
        members, lengths = rows[part], step[part]  # (b, S), (b, D)
        with np.errstate(over="ignore", invalid="ignore"):
            offset = (low[part] - query + lengths / 2).astype(np.float32)
            ends = (clip + half * lengths).astype(np.float32)
            start = (
                -rounding * half * lengths.sum(axis=1, keepdims=True) if clip else np.zeros((len(part), 1))
            )
            total = np.repeat(start.astype(np.float32), members.shape[1], axis=1)
            single = lengths.astype(np.float32)
            for axis in range(codes.shape[1]):
                apart = codes[part, axis] * single[:, axis, np.newaxis]
                apart += offset[:, axis, np.newaxis]
                np.abs(apart, out=apart)
                end = ends[:, axis, np.newaxis]
                if clip:
                    total += np.minimum(apart, end, out=apart)
                else:
                    total += np.square(np.maximum(apart - end, 0, out=apart), out=apart)
        within = ~(total > limit) & (members != NO_ROW)
        some = slice(found, found + np.count_nonzero(within))
        near[some], bounds[some] = members[within], total[within]
        found = some.stop
    return found
