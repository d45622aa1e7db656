"""Lower bounds of Euclidean distances: the shapes of a gallery that can be among the k nearest of a query.

An orthogonal projection does not increase the Euclidean distance. The sum of (p − q)² over the coordinates
along the first principal directions is therefore a lower bound of the square of ``log``, and of that of
``d2``, since ``log`` ≤ ``d2``.

The points are in blocks, the leaves of a k-d tree [1]_. The bounding box of a block is divided into 256 cells
along each axis, and a point is stored as the numbers of its cells, as in a VA-file [2]_. Of the distance
between a query and a point, the box gives a lower bound that all points of the block share, and the cells
give a larger one for the point alone. A few blocks are searched at a time, nearest blocks first:

1. Find the shapes in the blocks whose lower bound is at most the limit of the radius τ, which is infinite at
   first.
2. Compute the exact distances to those with the smallest bounds. At least k shapes are within the k-th
   smallest distance of the query, so that each of the k nearest neighbours is: it is the new τ.
3. Stop when the lower bounds of all other blocks exceed the limit. Because a lower bound does not exceed the
   exact distance, the shapes with a bound within the limit include the k nearest neighbours.

References
----------
.. [1] Friedman, Bentley and Finkel, "An algorithm for finding best matches in logarithmic expected time", ACM
   Transactions on Mathematical Software 1977.
.. [2] Weber, Schek and Blott, "A quantitative analysis and performance study for similarity-search methods in
   high-dimensional spaces", VLDB 1998.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.retrieval.covariances import scatter_matrix
from pcretrieve.retrieval.distances import CHUNK, Positions
from pcretrieve.values import FloatArray
from pcretrieve.values.compiled import compiled

Rows = NDArray[np.int32]
Singles = NDArray[np.float32]

# Least number of principal directions that the bounds are computed from, and least share of the variance that
# is along them. With fewer the bounds are looser and more shapes need an exact distance; with more the bounds
# take longer, yet less than a flat scan. See docs/decisions.md, N_LEADING.
N_LEADING = 24
SHARE = 0.95

# Largest number of the leading axes that the blocks are divided along. A million shapes are divided ten times
# before they are in blocks.
N_DIVIDING = 8

# Largest number of points in a block, of which blocks have a multiple of 64, so that they fill the vector
# registers of a processor.
BLOCK_SIZE = 1024
VECTOR = 64

N_CELLS = 256

# Largest number of points from which the axis is chosen that a set of points is divided along.
N_SAMPLED = 1000

# In place of a row where a block has fewer points than `BLOCK_SIZE`.
NO_ROW = -1

SINGLE = float(np.finfo(np.float32).eps)
LARGEST_SINGLE = float(np.finfo(np.float32).max)

# Half the length of a cell, and rounding errors in single precision of the distance to it, in units of its
# length: numbers of up to 512 lengths are rounded three times, and the factor of ten beyond that is without
# effect on the bounds.
HALF_CELL = 0.5 + 10 * 3 * 2 * N_CELLS * SINGLE

# Exact distances in the second step, relative to k, and largest number of shapes, relative to k, for which no
# smaller radius is computed after the last turn.
N_FIRST = 4
N_LAST = 16

# Number of blocks of the first turn, and its growth from turn to turn.
N_BLOCKS = 2
GROWTH = 16


class LowerBounds(NamedTuple):
    """The blocks of a table of points, of which each has at most S.

    mean: (L,) float64, mean of the points, which is subtracted from each.
    axes: (L, D) float64, orthonormal columns: the principal directions.
    rows: (B, S) int32, rows of the points of each block in the table, and `NO_ROW` in the other places.
    low, high: (B, D) float64, the smallest and the largest coordinates of each block along the axes.
    step: (B, D) float64, lengths of the cells of each block.
    codes: (B, D, S) uint8, numbers of the cells of each point along each axis.
    """

    mean: FloatArray
    axes: FloatArray
    rows: Rows
    low: FloatArray
    high: FloatArray
    step: FloatArray
    codes: NDArray[np.uint8]

    @classmethod
    def of(cls, points: FloatArray) -> LowerBounds:
        """The bounds of the distances to points (N, L), at least one."""
        mean = points.mean(axis=0)
        axes = _principal_axes(points, mean)
        leading = np.empty((min(N_DIVIDING, axes.shape[1]), len(points)), np.float32)
        with np.errstate(over="ignore"):
            for start in range(0, len(points), CHUNK):
                chunk = slice(start, start + CHUNK)
                leading[:, chunk] = ((points[chunk] - mean) @ axes[:, : len(leading)]).T
        parts = list(_leaves(leading, np.arange(len(points), dtype=np.int32)))
        size = -(-max(map(len, parts)) // VECTOR) * VECTOR
        rows = np.full((len(parts), size), NO_ROW, np.int32)
        low, high, step = (np.empty((len(parts), axes.shape[1])) for _ in range(3))
        codes = np.zeros((len(parts), axes.shape[1], size), np.uint8)
        for block, part in enumerate(parts):
            # Ascending, because that is the order of the points in memory.
            members = np.sort(part)
            along = (points[members] - mean) @ axes
            low[block], high[block] = along.min(axis=0), along.max(axis=0)
            # Not the difference by 256, because that of the largest numbers is infinite.
            step[block] = high[block] / N_CELLS - low[block] / N_CELLS
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                # 0 / 0 where all points are equal.
                cells = np.nan_to_num((along - low[block]) / step[block])
            rows[block, : len(members)] = members
            codes[block, :, : len(members)] = np.clip(cells, 0, N_CELLS - 1).T
        return cls(mean, axes, rows, low, high, step, codes)

    def fits(self, points: FloatArray) -> bool:
        """Whether the arrays are those of a table (N, L), which compiled code does not check."""
        (n_blocks, size), (n_values, n_axes) = self.rows.shape, self.axes.shape
        return (
            points.shape == (np.count_nonzero(self.rows != NO_ROW), n_values)
            and self.mean.shape == (n_values,)
            and self.low.shape == self.high.shape == self.step.shape == (n_blocks, n_axes)
            and self.codes.shape == (n_blocks, n_axes, size)
        )

    def cells(
        self, query: FloatArray
    ) -> tuple[NDArray[np.uint8], Rows, Singles, Singles, FloatArray]:
        """What the compiled `scan` reads of all blocks, for a query (D,)."""
        with np.errstate(over="ignore", invalid="ignore"):
            middle = (self.low - query + self.step / 2).astype(np.float32)
            reach = HALF_CELL * np.sqrt((self.step**2).sum(axis=1))
            return self.codes, self.rows, middle, self.step.astype(np.float32), reach

    def candidates(
        self, point: FloatArray, k: int, radius: Callable[[Rows], float]
    ) -> Positions:
        """The rows (n,), ascending, that include the `k` nearest to a point (L,) and all at equal distance.

        radius: function of (n,) rows that returns a distance within which at least `k` of them lie.
        """
        query = (point - self.mean) @ self.axes  # (D,)
        to_blocks, cells = self._to_blocks(query), self.cells(query)
        order = np.argsort(to_blocks, kind="stable")
        rows, to_rows = np.empty(0, np.int32), np.empty(0, np.float32)
        limit, start, n = math.inf, 0, N_BLOCKS
        while start < len(order) and to_blocks[order[start]] <= limit:
            chosen = order[start : start + n]
            near = np.sort(chosen[to_blocks[chosen] <= limit])  # as they are in memory
            found = scan(*cells, near, np.float32(limit))
            rows, to_rows = (
                np.concatenate([rows, found[0]]),
                np.concatenate([to_rows, found[1]]),
            )
            start, n = start + n, GROWTH * n
            is_last = start >= len(order) or to_blocks[order[start]] > limit
            if is_last and len(rows) <= N_LAST * k:
                break
            first = rows
            if N_FIRST * k < len(rows):
                first = rows[np.argpartition(to_rows, N_FIRST * k - 1)[: N_FIRST * k]]
            limit = min(limit, self._limit(radius(first)))
            within = ~(to_rows > limit)
            rows, to_rows = rows[within], to_rows[within]
        return np.sort(rows).astype(np.intp)

    def _to_blocks(self, query: FloatArray) -> FloatArray:
        """(B,) squares of lower bounds of the distances to blocks; zero where a number is too large."""
        gaps = np.maximum(np.maximum(self.low - query, query - self.high), 0.0)
        with np.errstate(over="ignore", invalid="ignore"):
            bounds: FloatArray = (gaps**2).sum(axis=1)
        bounds[np.isnan(bounds)] = 0
        return bounds

    def _limit(self, radius: float) -> float:
        """The largest bound that a point within a radius can have."""
        # The factor allows for rounding errors of D terms and of their partial sums.
        limit = (radius * radius) * (1 + 4 * (int(self.axes.shape[1]) + 8) * SINGLE)
        return limit if limit < LARGEST_SINGLE else math.inf


# Contraction to fused multiply-add instructions makes rounding errors smaller, which the limit allows for.
@compiled(nogil=True, fastmath={"contract"})
def scan(
    codes: NDArray[np.uint8],
    rows: Rows,
    middle: Singles,
    step: Singles,
    reach: FloatArray,
    blocks: Positions,
    limit: np.float32,
) -> tuple[Rows, Singles]:
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
            cells = codes[block, axis]
            for i in range(size):
                along = np.float32(cells[i]) * step[block, axis] + middle[block, axis]
                total[i] += along * along
        most = np.float32((math.sqrt(limit) + reach[block]) ** 2)
        for i in range(size):
            # The negation is true for a NaN too.
            if not (total[i] > most) and rows[block, i] >= 0:
                near[found] = rows[block, i]
                bounds[found] = max(math.sqrt(total[i]) - reach[block], 0.0) ** 2
                found += 1
    return near[:found], bounds[:found]


def _principal_axes(points: FloatArray, mean: FloatArray) -> FloatArray:
    """(L, D) the principal directions, the largest variance first, that have `SHARE` of the variance."""
    # Variances ascend.
    variances, directions = np.linalg.eigh(scatter_matrix(points, mean))
    small = np.cumsum(variances) < (1 - SHARE) * variances.sum()
    n_axes = max(N_LEADING, np.count_nonzero(~small))
    return np.ascontiguousarray(directions[:, ::-1][:, :n_axes])


def _leaves(leading: NDArray[np.float32], members: Rows) -> Iterator[Rows]:
    """Divide points by the median along the axis of largest variance, until few are left in each part."""
    if len(members) <= BLOCK_SIZE:
        yield members
        return
    with np.errstate(over="ignore", invalid="ignore"):
        sample = leading[:, members[:: -(-len(members) // N_SAMPLED)]]
        axis = np.argmax(np.nan_to_num(sample.var(axis=1)))
    half = len(members) // 2
    order = np.argpartition(leading[axis, members], half)
    yield from _leaves(leading, members[order[:half]])
    yield from _leaves(leading, members[order[half:]])
