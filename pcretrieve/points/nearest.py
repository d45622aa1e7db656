"""The points of a cloud that are nearest to given places, compiled by numba."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pcretrieve.values import FloatArray

__all__ = ["nearest"]

Index = NDArray[np.intp]
Shape = tuple[int, int, int]

# Mean number of points in an occupied cell of the grid, relative to the number of neighbours, by which most
# neighbourhoods are in a cell and those around it; and its smallest value. See docs/decisions.md, OCCUPANCY.
OCCUPANCY = 0.25
LEAST_OCCUPANCY = 1.0

# Largest number of points in one cell, relative to the wanted mean, and largest number of cells for each
# point. Beyond them the density varies so much that a k-d tree is faster than a grid.
MOST_CROWDED = 40
MOST_CELLS = 64

# Two distances that are nearer than this, relatively, are equal up to rounding errors.
ROUNDING = 1e-9


class Cells(NamedTuple):
    """The points of a cloud, sorted by the cells of a grid.

    low: (3,) float64, the corner of the grid.
    order: (n,) int, numbers of the points, grouped by cell.
    starts: (cells + 1,) int, position of the first point of each cell in `order`.
    """

    low: FloatArray
    edge: float
    shape: Shape
    order: Index
    starts: Index


def nearest(points: FloatArray, places: FloatArray, k: int) -> tuple[FloatArray, Index]:
    """Search for the points that are nearest to each place, by a grid of cells or a k-d tree.

    points: (n, 3) float64, the cloud; in any unit.
    places: (m, 3) float64, the places, which may be points of the cloud; unit of the points.
    Returns distance : (m, k) float64: distances, ascending; unit of the points.
    Returns near : (m, k) int: numbers of the points.
    """
    cells = _cells(points, k)
    if cells is not None:
        return _nearest(points, *cells, places, k)

    from scipy.spatial import cKDTree

    distance, near = cKDTree(points).query(places, k=np.arange(1, k + 1))
    return np.asarray(distance), np.asarray(near)


def _cells(points: FloatArray, k: int) -> Cells | None:
    """The points in cells of a suitable edge; None if there is no such edge."""
    low, high = (np.array([bound(column) for column in points.T]) for bound in (np.min, np.max))
    x, y, z = high - low
    wanted = max(OCCUPANCY * k, LEAST_OCCUPANCY)
    # The edge for a box, and then for the number of cells that this edge gives to the surface.
    edge = float(np.sqrt(wanted * (x * y + y * z + z * x) / len(points)))
    cells = None
    for _ in range(2):
        if not edge > 0:
            return None
        numbers = np.floor((high - low) / edge) + 1
        if numbers.prod() > MOST_CELLS * len(points):
            return None
        a, b, c = numbers.astype(int).tolist()
        order, starts = _sorted(points, low, edge, (a, b, c))
        cells = Cells(low, edge, (a, b, c), order, starts)
        crowd = np.diff(starts)
        edge *= float(np.sqrt(wanted * np.count_nonzero(crowd) / len(points)))
    return None if crowd.max() > MOST_CROWDED * wanted else cells


@njit(cache=True, error_model="numpy")
def _cell(x: float, low: float, edge: float, n: int) -> int:
    return min(max(int((x - low) / edge), 0), n - 1)


@njit(cache=True, error_model="numpy")
def _sorted(points: FloatArray, low: FloatArray, edge: float, shape: Shape) -> tuple[Index, Index]:
    """Numbers of the points, grouped by cell, and the position of the first one of each cell."""
    cell = np.empty(len(points), dtype=np.intp)
    starts = np.zeros(shape[0] * shape[1] * shape[2] + 1, dtype=np.intp)
    for i in range(len(points)):
        a = _cell(points[i, 0], low[0], edge, shape[0])
        b = _cell(points[i, 1], low[1], edge, shape[1])
        cell[i] = (a * shape[1] + b) * shape[2] + _cell(points[i, 2], low[2], edge, shape[2])
        starts[cell[i] + 1] += 1
    starts = np.cumsum(starts)
    fill = starts[:-1].copy()
    order = np.empty(len(points), dtype=np.intp)
    for i in range(len(points)):
        order[fill[cell[i]]] = i
        fill[cell[i]] += 1
    return order, starts


@njit(cache=True, error_model="numpy")
def _nearest(
    points: FloatArray,
    low: FloatArray,
    edge: float,
    shape: Shape,
    order: Index,
    starts: Index,
    places: FloatArray,
    k: int,
) -> tuple[FloatArray, Index]:
    """The nearest points in a block of cells around each place, which grows until none can be nearer."""
    distance, near = np.empty((len(places), k)), np.empty((len(places), k), dtype=np.intp)
    grouped = points[order]
    squares, found = np.empty(k), np.empty(k, dtype=np.intp)
    for q in range(len(places)):
        x, y, z = places[q, 0], places[q, 1], places[q, 2]
        a = _cell(x, low[0], edge, shape[0])
        b = _cell(y, low[1], edge, shape[1])
        c = _cell(z, low[2], edge, shape[2])
        n, ring = 0, 1
        while True:
            bottom, top = max(0, c - ring), min(shape[2] - 1, c + ring)
            for u in range(max(0, a - ring), min(shape[0], a + ring + 1)):
                for v in range(max(0, b - ring), min(shape[1], b + ring + 1)):
                    line = (u * shape[1] + v) * shape[2]
                    if ring == 1 or abs(u - a) == ring or abs(v - b) == ring:
                        # The points in the cells of one line follow each other.
                        first, last = starts[line + bottom], starts[line + top + 1]
                        n = _add(x, y, z, grouped, first, last, squares, found, n)
                        continue
                    if c - ring >= 0:
                        first, last = starts[line + bottom], starts[line + bottom + 1]
                        n = _add(x, y, z, grouped, first, last, squares, found, n)
                    if c + ring < shape[2]:
                        first, last = starts[line + top], starts[line + top + 1]
                        n = _add(x, y, z, grouped, first, last, squares, found, n)
            # Points outside the block are at least this far away.
            gap = np.inf
            for at, corner, cell, size in (
                (x, low[0], a, shape[0]),
                (y, low[1], b, shape[1]),
                (z, low[2], c, shape[2]),
            ):
                if cell - ring > 0:
                    gap = min(gap, at - corner - (cell - ring) * edge)
                if cell + ring + 1 < size:
                    gap = min(gap, corner + (cell + ring + 1) * edge - at)
            if gap == np.inf or (n == k and squares[k - 1] <= (1 - ROUNDING) * gap * gap):
                break
            ring += 1
        for j in range(k):
            distance[q, j], near[q, j] = np.sqrt(squares[j]), order[found[j]]
    return distance, near


@njit(cache=True, error_model="numpy")
def _add(
    x: float,
    y: float,
    z: float,
    grouped: FloatArray,
    first: int,
    last: int,
    squares: FloatArray,
    found: Index,
    n: int,
) -> int:
    """Add those of the points from `first` to `last` that are among the nearest; return their number."""
    k = len(squares)
    for i in range(first, last):
        u, v, w = grouped[i, 0] - x, grouped[i, 1] - y, grouped[i, 2] - z
        square = u * u + v * v + w * w
        if n < k:
            n += 1
        elif square >= squares[k - 1]:
            continue
        j = n - 1
        while j > 0 and squares[j - 1] > square:
            squares[j], found[j] = squares[j - 1], found[j - 1]
            j -= 1
        squares[j], found[j] = square, i
    return n
