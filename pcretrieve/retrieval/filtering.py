"""The filter of a nearest-neighbour search: the shapes of a gallery that can be among the k nearest.

Three steps, by the lower bounds of `pcretrieve.retrieval.lower_bounds`:

1. Compute a lower bound of the distance to every shape, and the exact distances to a few shapes with small
   bounds. Let τ be the k-th smallest of them: at least k shapes are within τ of the query, so that each of
   the k nearest neighbours is.
2. Keep the shapes with a lower bound of at most τ. They include the k nearest neighbours, because a lower
   bound does not exceed the exact distance.
3. Do both again with the shapes that are left, which gives a smaller τ.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import InputError
from pcretrieve.retrieval.distances import DISTANCES, pairwise
from pcretrieve.retrieval.lower_bounds import LowerBounds
from pcretrieve.types import FloatArray

__all__ = ["Filter"]

# Tolerance of the lower bound. The rounding error of a sum of L products of numbers of magnitude s is at most
# a few L·s·ε; this is the factor of L·s.
ROUNDING = 64 * float(np.finfo(np.float64).eps)

# Exact distances in the first step, relative to k, and the number of blocks of the table, relative to k, from
# each of which the shape with the smallest lower bound is taken. See docs/decisions.md, N_FIRST.
N_FIRST = 4
N_BLOCKS = 64


@dataclass(frozen=True, slots=True, eq=False)
class Filter:
    """The whitened coordinates of a gallery, and the bounds of their distances.

    Attributes
    ----------
    distance : str
        A name in `pcretrieve.retrieval.DISTANCES`.
    points : (N, L) float64
        The coordinates, at least one shape.
    size : float
        Largest magnitude of a coordinate, at least 1.
    bounds : LowerBounds or None
        None for a distance without lower bounds, by which no shape is left out.
    """

    distance: str
    points: FloatArray
    size: float
    bounds: LowerBounds | None

    @classmethod
    def of(cls, distance: str, points: FloatArray, n_leading: int | None = None) -> Filter:
        """The filter for coordinates, which are not copied.

        Parameters
        ----------
        distance : str
            A name in `pcretrieve.retrieval.DISTANCES`.
        points : (N, L) float64
            Whitened coordinates, at least one shape.
        n_leading : int, optional
            As in `LowerBounds.of`.

        Returns
        -------
        Filter
            With the bounds that the distance declares.
        """
        size = max(1.0, float(points.max()), -float(points.min()))
        bound = DISTANCES[distance].at_least
        return cls(distance, points, size, LowerBounds.of(bound, points, n_leading) if bound else None)

    def candidates(self, point: FloatArray, k: int) -> NDArray[np.intp]:
        """The shapes that can be among the k nearest.

        Parameters
        ----------
        point : (1, L) float64
            Whitened coordinates of the query.
        k : int
            Between 1 and N.

        Returns
        -------
        (n,) intp
            Rows of `points`, ascending, that include the `k` nearest and all rows at equal distance.
        """
        if self.bounds is None:
            return np.arange(len(self.points))
        bounds = self.bounds.to(point[0])  # (N,)
        # The smallest bound of each of many blocks is found faster than the smallest bounds of the table.
        length = max(1, len(bounds) // (N_BLOCKS * k))
        n_blocks = len(bounds) // length
        best = bounds[: n_blocks * length].reshape(n_blocks, length).argmin(axis=1)
        radius = self._radius(point, k, bounds, best + length * np.arange(n_blocks))
        rows = np.flatnonzero(~(bounds > self.bounds.limit(point[0], radius)))
        # Neighbours in one block were missed by the first step: the rows that are left include them.
        radius = min(radius, self._radius(point, k, bounds, rows))
        return rows[~(bounds[rows] > self.bounds.limit(point[0], radius))]

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """The contents as arrays by name: the input of `from_arrays`."""
        bounds = {} if self.bounds is None else self.bounds.to_arrays()
        return bounds | {
            "distance": np.array(self.distance),
            "gallery": self.points,
            "size": np.array(self.size),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Filter:
        """The filter that `to_arrays` has written as arrays.

        Parameters
        ----------
        arrays : mapping of str to array
            The arrays, which are not copied.

        Returns
        -------
        Filter
            The filter before.

        Raises
        ------
        InputError
            If the arrays are not of one table.
        KeyError
            If an array is missing.
        """
        distance, points = str(arrays["distance"]), arrays["gallery"]
        bound = DISTANCES[distance].at_least
        bounds = LowerBounds.from_arrays(bound, arrays) if bound else None
        if bounds is not None and bounds.table_shape != points.shape:
            raise InputError("the arrays of an index must be of one table, got several; build it again")
        return cls(distance, points, float(arrays["size"]), bounds)

    def _radius(
        self, point: FloatArray, k: int, bounds: NDArray[np.float32], rows: NDArray[np.intp]
    ) -> float:
        """A radius within which at least `k` of some rows lie, rounding errors included."""
        n = min(N_FIRST * k, len(rows))
        first = rows[np.argpartition(bounds[rows], n - 1)[:n]]
        exact = pairwise(self.distance, point, self.points[first])[0]
        farthest = float(np.partition(exact, k - 1)[k - 1])
        size = max(self.size, float(np.abs(point).max(initial=0)))
        radius: float = farthest + ROUNDING * (farthest + size * point.shape[1])
        return radius
