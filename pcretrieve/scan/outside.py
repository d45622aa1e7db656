"""The space outside a body, found by flood fill on a voxel grid, and distance maps on the grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pcretrieve.types import FloatArray

__all__ = ["Grid", "Outside", "distances", "flood"]

Mask = NDArray[np.bool_]
Voxels = NDArray[np.float32]

# Number of empty voxels around the points, in which finite differences are computed.
MARGIN = 3

# Largest distance to the points that is measured; in voxels. No function uses larger ones.
FARTHEST = 12.0

# Smallest distance of the outside from every point; in voxels. Points that sample a
# surface with about one point in each voxel leave gaps, which this distance closes.
# It is small enough for the outside to reach between fingers.
SKIN = 1.8


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """A grid of cubic voxels. The coordinates of a voxel are those of its centre.

    Attributes
    ----------
    origin : (3,) float64
        Centre of voxel (0, 0, 0); unit of the file.
    cell : float
        Edge of a voxel; unit of the file.
    shape : tuple of int, length 3
        Number of voxels along each axis.
    """

    origin: FloatArray
    cell: float
    shape: tuple[int, int, int]

    @classmethod
    def around(cls, points: FloatArray, cell: float, margin: int, shift: FloatArray | float = 0.0) -> Grid:
        """The smallest grid that contains points and a margin.

        Parameters
        ----------
        points : (n, 3) float64
            Coordinates; unit of the file.
        cell : float
            Edge of a voxel; unit of the file.
        margin : int
            Number of additional voxels on every side.
        shift : (3,) float64 or float, default 0.0
            Displacement of the grid in the negative directions; in voxels.

        Returns
        -------
        Grid
            Every point is in a voxel of it.
        """
        low, high = points.min(axis=0) - np.asarray(shift) * cell, points.max(axis=0)
        n_x, n_y, n_z = (np.ceil((high - low) / cell).astype(int) + 2 * margin + 1).tolist()
        return cls(low - margin * cell, cell, (n_x, n_y, n_z))

    def coordinates(self, points: FloatArray) -> FloatArray:
        """(n, 3) coordinates of points in voxels, integer at the centres."""
        return (points - self.origin) / self.cell

    def index(self, points: FloatArray) -> tuple[NDArray[np.intp], ...]:
        """Indices, for an array of `shape`, of the voxels that contain the points."""
        return tuple(np.rint(self.coordinates(points)).astype(np.intp).T)


@dataclass(frozen=True, slots=True, eq=False)
class Outside:
    """The outside of a body.

    Attributes
    ----------
    grid : Grid
        The grid of the arrays.
    wet : bool array of `grid.shape`
        Voxels outside, which the flood fill has reached.
    depth : float32 array of `grid.shape`
        Distance to the nearest voxel outside; in voxels.
    distance : float32 array of `grid.shape`
        Distance to the nearest voxel with a point, at most `FARTHEST` or the thickness of the walls + 1; in
        voxels.
    """

    grid: Grid
    wet: Mask
    depth: Voxels
    distance: Voxels

    def depth_at(self, points: FloatArray) -> FloatArray:
        """(n,) depths of points below the outside, by trilinear interpolation; in voxels."""
        return _sampled(self.depth, self.grid.coordinates(points))

    def direction_at(self, points: FloatArray) -> FloatArray:
        """(n, 3) unit vectors in the direction of steepest descent of the depth; zero if there is none."""
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
    """Find the outside of a body by flood fill from the border of a grid.

    First, the voxels within the distance `gap` of a point are walls, which close holes of the scan. Then the
    flood fill continues from the voxels reached through those between walls and points, for as many steps as
    the walls are thick, so that it reaches the space between fingers too, which the walls had closed.

    Parameters
    ----------
    points : (n, 3) float64
        Coordinates; unit of the file.
    cell : float
        Edge of a voxel, about the spacing of the points; unit of the file.
    gap : float
        Radius of the largest hole that is closed; unit of the file.
    shift : (3,) float64 or float, default 0.0
        Displacement of the grid in the negative directions; in voxels.
    deepest : float, default infinity
        Largest depth that is measured; in voxels.

    Returns
    -------
    Outside
        The voxels outside, and the distances to them and to the points.
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
    """The distance of each voxel to the nearest source voxel, by propagation of the nearest source [1]_.

    The propagation visits only voxels within the limit, unlike a distance transform of the whole grid. With a
    26-neighbourhood its error is less than a tenth of a voxel.

    Parameters
    ----------
    sources : (a, b, c) bool
        The source voxels.
    limit : float
        Largest distance; in voxels.

    Returns
    -------
    (a, b, c) float32
        Distances, at most `limit`; in voxels.

    References
    ----------
    .. [1] P.-E. Danielsson, "Euclidean distance mapping", Computer Graphics and Image Processing 14 (1980).
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
                # The propagation starts at the boundary of the sources.
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
    """Voxels reached from the border: outside the walls, then by as many steps as they are thick."""
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
    # Breadth-first search; the second pass starts from all voxels that the first has reached.
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
    """(n,) values at (n, 3) positions, by trilinear interpolation."""
    from scipy.ndimage import map_coordinates

    return np.asarray(map_coordinates(values, at.T, order=1), dtype=np.float64)
