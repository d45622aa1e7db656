"""The filter of a nearest-neighbour search: the shapes of a gallery that can be among the k nearest.

By the lower bounds of `pcretrieve.retrieval.lower_bounds`, a few blocks of shapes at a time, nearest blocks
first:

1. Find the shapes in the blocks whose lower bound is at most the limit of the radius τ, which is infinite at
   first.
2. Compute the exact distances to those with the smallest bounds. At least k shapes are within the k-th
   smallest distance of the query, so that each of the k nearest neighbours is: it is the new τ.
3. Stop when the lower bounds of all other blocks exceed the limit. Because a lower bound does not exceed the
   exact distance, the shapes with a bound within the limit include the k nearest neighbours.

A search of `pcretrieve.retrieval.searches`, if one is asked for, replaces the lower bounds: the exact
distances to the shapes that it finds first give the radius τ, within which it then has to find all shapes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import InputError
from pcretrieve.retrieval.blocks import NO_ROW, Rows
from pcretrieve.retrieval.distances import DISTANCES, pairwise
from pcretrieve.retrieval.interpreted import scan
from pcretrieve.retrieval.lower_bounds import LowerBounds
from pcretrieve.retrieval.searches import SEARCHES, EuclideanSearch, check_searchable
from pcretrieve.values import FloatArray

__all__ = ["Filter"]

# Largest number of shapes that are all compared with each query, which takes as long as to find a few of them
# by lower bounds. See docs/decisions.md, N_ALL.
N_ALL = 1000

# Tolerance of the lower bound. The rounding error of a sum of L products of numbers of magnitude s is at most
# a few L·s·ε, and that of a vector of up to L such sums √L times as large; this is the factor of L²·s.
ROUNDING = 64 * float(np.finfo(np.float64).eps)

# Largest magnitude of coordinates that a search of another package is asked for: squares of their distances
# do not overflow in single precision, up to a million values.
LARGEST = 1e15

# Exact distances in the second step, relative to k. See docs/decisions.md, N_FIRST.
N_FIRST = 4

# Largest number of shapes, relative to k, for which no smaller radius is computed after the last turn. See
# docs/decisions.md, N_FIRST.
N_LAST = 16

# Number of blocks of the first turn, and its growth from turn to turn. See docs/decisions.md, N_BLOCKS.
N_BLOCKS = 2
GROWTH = 16


@dataclass(frozen=True, slots=True, eq=False)
class Filter:
    """The whitened coordinates of a gallery, and the bounds of their distances.

    points: (N, L) float64, the coordinates, at least one shape.
    """

    distance: str
    points: FloatArray
    size: float
    bounds: LowerBounds | None
    nearest: str = "scan"
    search: EuclideanSearch | None = None

    @classmethod
    def of(
        cls, distance: str, points: FloatArray, n_leading: int | None = None, *, nearest: str = "auto"
    ) -> Filter:
        """The filter for coordinates, which are not copied.

        points: (N, L) float64, whitened coordinates, at least one shape.
        """
        check_searchable(nearest, distance)
        size = max(1.0, float(points.max()), -float(points.min()))
        if nearest in SEARCHES:
            search = SEARCHES[nearest](points) if size < LARGEST else None
            return cls(distance, points, size, None, nearest, search)
        bound = DISTANCES[distance].at_least if len(points) > N_ALL else None
        return cls(distance, points, size, LowerBounds.of(bound, points, n_leading) if bound else None)

    def __str__(self) -> str:
        if self.search is not None:
            return str(self.search)
        if self.bounds is None:
            return "all shapes compared"
        n_blocks, n_axes, size = self.bounds.blocks.codes.shape
        axes = "directions" if self.bounds.euclidean else "values"
        return f"{n_blocks} blocks of up to {size} shapes, bounds of {n_axes} {axes}"

    def extended(self, points: FloatArray, numbers: Rows, rows: Rows) -> Filter:
        """The filter with further shapes.

        points: (N + n, L) float64, the coordinates of all shapes.
        numbers: (N,) int32, the row of `points` of each shape that the filter has.
        rows: (n,) int32, the rows of the further shapes.
        """
        if self.bounds is None:
            return Filter.of(self.distance, points, nearest=self.nearest)
        size = max(self.size, float(np.abs(points[rows]).max()))
        return Filter(self.distance, points, size, self.bounds.renumbered(numbers).extended(points, rows))

    def kept(self, keep: NDArray[np.bool_]) -> Filter:
        """The filter of some of the shapes.

        keep: (N,) bool, which ones; at least one.
        """
        if self.search is not None:
            return Filter.of(self.distance, self.points[keep], nearest=self.nearest)
        numbers = np.where(keep, np.cumsum(keep) - 1, NO_ROW).astype(np.int32)
        bounds = None if self.bounds is None else self.bounds.renumbered(numbers)
        return Filter(self.distance, self.points[keep], self.size, bounds, self.nearest)

    def candidates(self, point: FloatArray, k: int, scan: Callable[..., int] = scan) -> NDArray[np.intp]:
        """The shapes that can be among the k nearest.

        point: (1, L) float64, whitened coordinates of the query.
        Returns (n,) intp: rows of `points`, ascending, that include the `k` nearest and all rows at equal
            distance.
        """
        if self.search is not None and k < len(self.points) and np.abs(point).max() < LARGEST:
            return self._found(self.search, point, k)
        if self.bounds is None:
            return np.arange(len(self.points))
        query = self.bounds.query(point[0])
        to_blocks = self.bounds.to_blocks(query)
        order = np.argsort(to_blocks, kind="stable")
        rows, to_rows = np.empty(0, np.int32), np.empty(0, np.float32)
        limit, start, n = math.inf, 0, N_BLOCKS
        while start < len(order) and to_blocks[order[start]] <= limit:
            chosen = order[start : start + n]
            found = self.bounds.to_rows(query, chosen[to_blocks[chosen] <= limit], limit, scan)
            rows, to_rows = np.concatenate([rows, found[0]]), np.concatenate([to_rows, found[1]])
            start, n = start + n, GROWTH * n
            is_last = start >= len(order) or to_blocks[order[start]] > limit
            if is_last and len(rows) <= N_LAST * k:
                break
            limit = min(limit, self.bounds.limit(self._radius(point, k, _first(rows, to_rows, N_FIRST * k))))
            near = ~(to_rows > limit)
            rows, to_rows = rows[near], to_rows[near]
        return np.sort(rows).astype(np.intp)

    def _found(self, search: EuclideanSearch, point: FloatArray, k: int) -> NDArray[np.intp]:
        """As `candidates`, by a search of another package."""
        rows, others = search.nearest(point, min(N_FIRST * k, len(self.points)))
        # No distance for which there are searches is less than the Euclidean one.
        radius = self._radius(point, k, rows)
        if not math.isfinite(radius):
            return np.arange(len(self.points))
        return np.sort(rows if radius < others else search.within(point, radius))

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """The contents as arrays by name: the input of `from_arrays`. Searches are made again from them."""
        bounds = {} if self.bounds is None else self.bounds.to_arrays()
        return bounds | {
            "distance": np.array(self.distance),
            "nearest": np.array(self.nearest),
            "gallery": self.points,
            "size": np.array(self.size),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Filter:
        """The filter that `to_arrays` has written as arrays."""
        distance, points, nearest = str(arrays["distance"]), arrays["gallery"], str(arrays["nearest"])
        if nearest in SEARCHES:
            return cls.of(distance, points, nearest=nearest)
        bound = DISTANCES[distance].at_least
        bounds = LowerBounds.from_arrays(bound, arrays) if bound and "codes" in arrays else None
        if bounds is not None and not bounds.fits(points):
            raise InputError("the arrays of an index must be of one table, got several; build it again")
        return cls(distance, points, float(arrays["size"]), bounds)

    def _radius(self, point: FloatArray, k: int, rows: NDArray[np.integer]) -> float:
        """A radius within which at least `k` of some rows lie, rounding errors included."""
        if len(rows) < k:
            return math.inf
        exact = pairwise(self.distance, point, self.points[rows])[0]
        farthest = float(np.partition(exact, k - 1)[k - 1])
        size = max(self.size, float(np.abs(point).max(initial=0)))
        radius: float = farthest + ROUNDING * (farthest + size * point.shape[1] ** 2)
        return radius


def _first(rows: Rows, bounds: NDArray[np.float32], n: int) -> Rows:
    """The `n` rows with the smallest bounds, or all rows if there are fewer."""
    return rows[np.argpartition(bounds, n - 1)[:n]] if n < len(rows) else rows
