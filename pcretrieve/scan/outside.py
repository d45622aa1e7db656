"""The space outside a body, on a grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pcretrieve.types import FloatArray

__all__ = ["Grid", "Outside", "distances", "flood"]

Mask = NDArray[np.bool_]
Voxels = NDArray[np.float32]

# Free voxels round the points: room for walls, and for a gradient at the outermost point.
MARGIN = 3

# Beyond this, the distance to the points matters to nobody; cells.
FARTHEST = 12.0

# A surface sampled at about one point a cell is tight only when thickened: the outside stays this far from
# every point; cells. Wide enough for the gaps of random sampling, narrow enough to reach between fingers.
SKIN = 1.8


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """Cubic cells over a piece of space; a cell is known by its centre.

    Attributes
    ----------
    origin : (3,) float64
        Centre of cell (0, 0, 0), in the unit of the file.
    cell : float
        Edge of a cell, in the unit of the file.
    shape : tuple of int, length 3
    """

    origin: FloatArray
    cell: float
    shape: tuple[int, int, int]

    @classmethod
    def around(cls, points: FloatArray, cell: float, margin: int, shift: FloatArray | float = 0.0) -> Grid:
        """The cells that hold (n, 3) points, and `margin` more on every side, `shift` cells lower."""
        low, high = points.min(axis=0) - np.asarray(shift) * cell, points.max(axis=0)
        n_x, n_y, n_z = (np.ceil((high - low) / cell).astype(int) + 2 * margin + 1).tolist()
        return cls(low - margin * cell, cell, (n_x, n_y, n_z))

    def coordinates(self, points: FloatArray) -> FloatArray:
        """(n, 3) positions in cells: whole numbers at the centres."""
        return (points - self.origin) / self.cell

    def index(self, points: FloatArray) -> tuple[NDArray[np.intp], ...]:
        """Of the cells that hold the points, ready to index an array of `shape`."""
        return tuple(np.rint(self.coordinates(points)).astype(np.intp).T)


@dataclass(frozen=True, slots=True, eq=False)
class Outside:
    """Where the outside is.

    Attributes
    ----------
    grid : Grid
    wet : bool array of `grid.shape`
        Cells that the outside reaches.
    depth : float32 array of `grid.shape`
        Distance to the nearest wet cell; cells.
    distance : float32 array of `grid.shape`
        Distance to the nearest cell that holds a point, at most `FARTHEST`; cells.
    """

    grid: Grid
    wet: Mask
    depth: Voxels
    distance: Voxels

    def depth_at(self, points: FloatArray) -> FloatArray:
        """(n,) depths below the outside; cells."""
        return _sampled(self.depth, self.grid.coordinates(points))

    def direction_at(self, points: FloatArray) -> FloatArray:
        """(n, 3) unit vectors towards the nearest outside; zero where no side is nearer."""
        at = self.grid.coordinates(points)
        slope = np.empty((len(points), 3))
        for axis, step in enumerate(np.eye(3)):
            slope[:, axis] = _sampled(self.depth, at - step) - _sampled(self.depth, at + step)
        length = np.linalg.norm(slope, axis=1, keepdims=True)
        return slope / np.where(length > 0, length, 1)


def flood(
    points: FloatArray,
    *,
    cell: float,
    gap: float,
    shift: FloatArray | float = 0.0,
    deepest: float = np.inf,
) -> Outside:
    """Flood the outside from a corner of the bounding box.

    Walls as thick as `gap` keep the flood out of holes in the scan; what stays wet then creeps through the
    free cells between wall and points, so that it also comes between fingers, which the walls had closed.

    Parameters
    ----------
    points : (n, 3) float64
    cell : float
        Edge of a cell; about the spacing of the points, unit of the file.
    gap : float
        Radius of the largest hole that is kept shut; unit of the file.
    shift : (3,) float64 or 0
        Of the cells against the points; cells.
    deepest : float
        Depths beyond this are not measured; cells.
    """
    wall = gap / cell
    grid = Grid.around(points, cell, int(np.ceil(wall)) + MARGIN, shift)
    occupied = np.zeros(grid.shape, dtype=bool)
    occupied[grid.index(points)] = True
    distance = distances(occupied, max(FARTHEST, wall + 1))
    wet = _flooded(distance, wall, SKIN)
    return Outside(grid, wet, distances(wet, deepest), distance)


@njit(cache=True)
def distances(sources: Mask, limit: float) -> Voxels:
    """Distance of each cell to the nearest source, and at most `limit`; cells.

    A wave runs out from the sources and carries the nearest one along: work is done only where the wave
    comes, unlike in a transform of the whole grid (Danielsson, "Euclidean distance mapping", 1980; the error
    of a wave over 26 neighbours stays below a tenth of a cell).
    """
    n_x, n_y, n_z = sources.shape
    n = sources.size
    result = np.full(n, limit, dtype=np.float32)
    nearest = np.empty(n, dtype=np.int32)
    is_source = sources.ravel()
    front = np.empty(n, dtype=np.int32)
    queued = np.zeros(n, dtype=np.bool_)
    count = 0
    for x in range(n_x):
        for y in range(n_y):
            for z in range(n_z):
                cell = (x * n_y + y) * n_z + z
                if not is_source[cell]:
                    continue
                result[cell] = 0
                nearest[cell] = cell
                # Only sources with another cell beside them send the wave out.
                if (
                    (x > 0 and not is_source[cell - n_y * n_z])
                    or (x < n_x - 1 and not is_source[cell + n_y * n_z])
                    or (y > 0 and not is_source[cell - n_z])
                    or (y < n_y - 1 and not is_source[cell + n_z])
                    or (z > 0 and not is_source[cell - 1])
                    or (z < n_z - 1 and not is_source[cell + 1])
                ):
                    front[count] = cell
                    queued[cell] = True
                    count += 1
    head, waiting = 0, count
    tail = count % n
    while waiting:
        cell = front[head]
        head = (head + 1) % n
        waiting -= 1
        queued[cell] = False
        source = nearest[cell]
        a, b, c = source // (n_y * n_z), source // n_z % n_y, source % n_z
        x, y, z = cell // (n_y * n_z), cell // n_z % n_y, cell % n_z
        for u in range(max(0, x - 1), min(n_x, x + 2)):
            for v in range(max(0, y - 1), min(n_y, y + 2)):
                for w in range(max(0, z - 1), min(n_z, z + 2)):
                    other = (u * n_y + v) * n_z + w
                    apart = np.float32(np.sqrt((u - a) ** 2 + (v - b) ** 2 + (w - c) ** 2))
                    if apart < result[other]:
                        result[other] = apart
                        nearest[other] = source
                        if not queued[other]:
                            queued[other] = True
                            front[tail] = other
                            tail = (tail + 1) % n
                            waiting += 1
    return result.reshape(sources.shape)


@njit(cache=True)
def _flooded(distance: Voxels, wall: float, skin: float) -> Mask:
    """Cells reached from the border: first outside the walls only, then as many steps as a wall is thick.

    The border must lie outside the walls.
    """
    _, n_y, n_z = distance.shape
    to_points = distance.ravel()
    is_wet = np.zeros(distance.size, dtype=np.bool_)
    wet = is_wet.reshape(distance.shape)
    wet[0], wet[-1] = True, True
    wet[:, 0], wet[:, -1] = True, True
    wet[:, :, 0], wet[:, :, -1] = True, True
    step = (n_y * n_z, n_z, 1)
    front = np.empty(distance.size, dtype=np.int32)
    steps = np.zeros(distance.size, dtype=np.int16)
    front[0] = n_y * n_z + n_z + 1
    is_wet[front[0]] = True
    n = 1
    most = int(wall) + 1
    # Breadth first; the second pass starts from everything that the first has reached.
    for creeping in range(2):
        limit = skin if creeping else wall
        i = 0
        while i < n:
            cell = front[i]
            i += 1
            if creeping and steps[i - 1] >= most:
                continue
            for axis in range(3):
                for other in (cell - step[axis], cell + step[axis]):
                    if is_wet[other] or to_points[other] <= limit:
                        continue
                    is_wet[other] = True
                    front[n] = other
                    steps[n] = steps[i - 1] + 1 if creeping else 0
                    n += 1
    return wet


def _sampled(values: Voxels, at: FloatArray) -> FloatArray:
    """(n,) values between cells, trilinear."""
    from scipy.ndimage import map_coordinates

    return np.asarray(map_coordinates(values, at.T, order=1), dtype=np.float64)
