"""Points in blocks of neighbouring points, with eight bits for each coordinate.

The leaves of a k-d tree [1]_ are the blocks. The bounding box of a block is divided into 256 cells along each
axis, or along its longest axis only, with cells of the same length along the others. A point is stored as the
numbers of its cells, as in a VA-file [2]_. Of the distance between a query
and a point, the box gives a lower bound that all points of the block share, and the cells give a larger lower
bound for the point alone.

References
----------
.. [1] Friedman, Bentley and Finkel, "An algorithm for finding best matches in logarithmic expected time", ACM
   Transactions on Mathematical Software 1977.
.. [2] Weber, Schek and Blott, "A quantitative analysis and performance study for similarity-search methods in
   high-dimensional spaces", VLDB 1998.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcretrieve.values import FloatArray

__all__ = ["NO_ROW", "N_CELLS", "Blocks", "Codes", "Rows"]

Rows = NDArray[np.int32]
Codes = NDArray[np.uint8]

# Largest number of points in a block. See docs/decisions.md, BLOCK_SIZE.
BLOCK_SIZE = 1024

# Number of points of which blocks have a multiple, so that they fill the vector registers of a processor.
VECTOR = 64

N_CELLS = 256

# Smallest length of a cell if all have the same length, so that it is not zero where all points are equal.
SHORTEST = float(np.finfo(np.float64).tiny)

# Largest number of points from which the axis is chosen that a set of points is divided along.
N_SAMPLED = 1000

# In place of a row where a block has fewer points than `BLOCK_SIZE`.
NO_ROW = -1


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """The blocks of a table of points with D coordinates.

    rows: (B, S) int32, rows of the points of each block in the table, and `NO_ROW` in the other places.
    low, high: (B, D) float64, the smallest and the largest coordinates of each block.
    step: (B, D) float64, lengths of the cells of each block.
    codes: (B, D, S) uint8, numbers of the cells of each point along each axis.
    """

    rows: Rows
    low: FloatArray
    high: FloatArray
    step: FloatArray
    codes: Codes

    @classmethod
    def of(
        cls,
        leading: NDArray[np.float32],
        coordinates: Callable[[Rows], FloatArray],
        rows: Rows,
        *,
        cubic: bool,
        size: int | None = None,
    ) -> Blocks:
        """The blocks of some rows of a table.

        leading: (d, n) float32, coordinates of the rows along the axes that may divide them.
        coordinates: function of (m,) int32 that returns (m, D) float64, coordinates of rows of the table.
        rows: (n,) int32, the rows, at least one.
        """
        parts = list(_leaves(leading, np.arange(len(rows), dtype=np.int32), size or BLOCK_SIZE))
        if size is None:
            size = -(-max(map(len, parts)) // VECTOR) * VECTOR
        n_axes = coordinates(rows[:1]).shape[1]
        blocks = cls(
            np.full((len(parts), size), NO_ROW, np.int32),
            np.empty((len(parts), n_axes)),
            np.empty((len(parts), n_axes)),
            np.empty((len(parts), n_axes)),
            np.zeros((len(parts), n_axes, size), np.uint8),
        )
        for block, part in enumerate(parts):
            # In ascending order, because that is the order of the points in memory.
            blocks._fill(block, members := np.sort(rows[part]), coordinates(members), cubic)
        return blocks

    def _fill(self, block: int, rows: Rows, points: FloatArray, cubic: bool) -> None:
        """Set one block of arrays that are not yet in use to the points (m, D) of some rows (m,)."""
        low, high = points.min(axis=0), points.max(axis=0)
        step = high / N_CELLS - low / N_CELLS  # the difference of the largest numbers is infinite
        if cubic:
            step = np.full_like(step, max(step.max(), SHORTEST))
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            cells = np.nan_to_num((points - low) / step)  # 0 / 0 where all points are equal
        self.rows[block, : len(rows)] = rows
        self.low[block], self.high[block], self.step[block] = low, high, step
        self.codes[block, :, : len(rows)] = np.clip(cells, 0, N_CELLS - 1).T

    @property
    def n_rows(self) -> int:
        """The number of rows in all blocks."""
        return int(np.count_nonzero(self.rows != NO_ROW))

    def gaps(self, query: FloatArray) -> FloatArray:
        """Distances along each axis between a query and the bounding boxes.

        query: (D,) float64, coordinates of the query.
        Returns (B, D) float64: zero where the query is between the ends of the box.
        """
        return np.maximum(np.maximum(self.low - query, query - self.high), 0.0)

    def renumbered(self, numbers: Rows) -> Blocks:
        """The blocks after rows of the table were moved or removed.

        numbers: (N,) int32, the new number of each row of the table, or `NO_ROW` if it was removed.
        """
        rows = np.where(self.rows == NO_ROW, np.int32(NO_ROW), numbers[self.rows])
        if (used := (rows != NO_ROW).any(axis=1)).all():
            return replace(self, rows=rows)
        return Blocks(rows[used], self.low[used], self.high[used], self.step[used], self.codes[used])

    def extended(self, coordinates: Callable[[Rows], FloatArray], rows: Rows, *, cubic: bool) -> Blocks:
        """The blocks with further rows, which are stored in new blocks beside those of the last block.

        coordinates: function of (m,) int32 that returns (m, D) float64, coordinates of rows of the table.
        rows: (n,) int32, the further rows.
        """
        last = self.rows[-1]
        rows = np.concatenate([last[last != NO_ROW], rows])
        with np.errstate(over="ignore"):
            leading = np.ascontiguousarray(coordinates(rows).T, np.float32)
        new = Blocks.of(leading, coordinates, rows, cubic=cubic, size=len(last))
        return Blocks(
            *(np.concatenate([old[:-1], new.to_arrays()[name]]) for name, old in self.to_arrays().items())
        )

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """The attributes as arrays by name: the input of `from_arrays`."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Blocks:
        """The blocks that `to_arrays` has written as arrays."""
        return cls(**{field.name: arrays[field.name] for field in fields(cls)})


def _leaves(leading: NDArray[np.float32], members: Rows, size: int) -> Iterator[Rows]:
    """Divide points by the median along the axis of largest variance, until few are left in each part."""
    if len(members) <= size:
        yield members
        return
    with np.errstate(over="ignore", invalid="ignore"):
        sample = leading[:, members[:: -(-len(members) // N_SAMPLED)]]
        axis = np.argmax(np.nan_to_num(sample.var(axis=1)))
    half = len(members) // 2
    order = np.argpartition(leading[axis, members], half)
    yield from _leaves(leading, members[order[:half]], size)
    yield from _leaves(leading, members[order[half:]], size)
