"""The flat scan of faiss: Euclidean nearest neighbours by all distances, in single precision.

faiss is installed by the extra ``faiss`` (``pip install pcretrieve[faiss]``).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pcretrieve.arrays import FloatArray
from pcretrieve.errors import InputError

__all__ = ["FlatScan"]

SINGLE = float(np.finfo(np.float32).eps)
LARGEST_SINGLE = float(np.finfo(np.float32).max)


class FlatScan:
    """The points of a table in single precision.

    For one query, faiss sums the squares of the differences. Let u be the rounding error of single precision,
    L the number of values, s the largest magnitude of a coordinate and d the distance of two points. Rounding
    of the points changes d by at most 2 √L s u, and the sum of L squares has a relative error of at most
    (L + 2) u. The distance that faiss finds is therefore within (L + 8) u (d + 2 √L s) of d.

    points: (N, L) float64, the points, at least one. The squares of their distances do not overflow single
        precision.
    """

    def __init__(self, points: FloatArray) -> None:
        try:
            import faiss
        except ImportError as error:
            raise InputError(
                "nearest = 'faiss' needs faiss, which is not installed: pip install 'pcretrieve[faiss]'"
            ) from error
        n_values = points.shape[1]
        self._size = max(float(points.max()), -float(points.min()))
        self._relative = (n_values + 8) * SINGLE
        self._absolute = 2 * math.sqrt(n_values)
        self._flat = faiss.IndexFlatL2(n_values)
        self._flat.add(np.ascontiguousarray(points, np.float32))

    def __str__(self) -> str:
        return "flat scan of faiss"

    def nearest(self, point: FloatArray, k: int) -> tuple[NDArray[np.intp], float]:
        """Points that are the nearest, apart from rounding errors.

        point: (1, L) float64, the query.
        Returns rows : (k,) intp: the points.
        """
        squares, rows = self._flat.search(point.astype(np.float32), k)
        farthest = math.sqrt(squares[0, -1])
        return rows[0], farthest - self._error(point, farthest)

    def within(self, point: FloatArray, radius: float) -> NDArray[np.intp]:
        """Points near a query, all within a radius among them.

        point: (1, L) float64, the query.
        Returns (n,) intp: the points.
        """
        reach = radius + self._error(point, radius)
        square = min(reach * reach, LARGEST_SINGLE)
        _, _, rows = self._flat.range_search(point.astype(np.float32), square)
        return np.asarray(rows, dtype=np.intp)

    def _error(self, point: FloatArray, distance: float) -> float:
        size = max(self._size, float(np.abs(point).max()))
        error: float = self._relative * (distance + self._absolute * size)
        return error
