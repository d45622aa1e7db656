"""The space outside a body, found by flood fill on a voxel grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from pcretrieve.types import FloatArray
from pcretrieve.voxels.distance import distances
from pcretrieve.voxels.grid import Grid, Mask, Voxels

__all__ = ["FARTHEST", "Outside", "flood"]

# Number of empty voxels around the points, in which finite differences are computed.
MARGIN = 3

# Largest distance to the points that is measured; in voxels. No function uses larger ones.
FARTHEST = 12.0

# Smallest distance of the outside from every point; in voxels. Points that sample a
# surface with about one point in each voxel leave gaps, which this distance closes.
# It is small enough for the outside to reach between fingers.
CLEARANCE = 1.8


@dataclass(frozen=True, slots=True, eq=False)
class Outside:
    """The outside of a body.

    Attributes
    ----------
    grid : Grid
        The grid of the arrays.
    reached : bool array of `grid.shape`
        Voxels outside, which the flood fill has reached.
    depth : float32 array of `grid.shape`
        Distance to the nearest voxel outside; in voxels.
    distance : float32 array of `grid.shape`
        Distance to the nearest voxel with a point, at most `FARTHEST` or the thickness of the walls + 1; in
        voxels.
    """

    grid: Grid
    reached: Mask
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
    reached = _flooded(distance, wall, CLEARANCE)
    return Outside(grid, reached, distances(reached, deepest), distance)


@njit(cache=True)
def _flooded(distance: Voxels, wall: float, clearance: float) -> Mask:
    """Voxels reached from the border: outside the walls, then by as many steps as they are thick."""
    _, n_y, n_z = distance.shape
    to_points = distance.ravel()
    is_reached = np.zeros(distance.size, dtype=np.bool_)
    reached = is_reached.reshape(distance.shape)
    reached[0], reached[-1] = True, True
    reached[:, 0], reached[:, -1] = True, True
    reached[:, :, 0], reached[:, :, -1] = True, True
    step = (n_y * n_z, n_z, 1)
    front = np.empty(distance.size, dtype=np.int32)
    steps = np.zeros(distance.size, dtype=np.int16)
    front[0] = n_y * n_z + n_z + 1
    is_reached[front[0]] = True
    n = 1
    most = int(wall) + 1
    # Breadth-first search; the second pass starts from all voxels that the first has reached.
    for second in range(2):
        limit = clearance if second else wall
        i = 0
        while i < n:
            cell = front[i]
            i += 1
            if second and steps[i - 1] >= most:
                continue
            for axis in range(3):
                for other in (cell - step[axis], cell + step[axis]):
                    if is_reached[other] or to_points[other] <= limit:
                        continue
                    is_reached[other] = True
                    front[n] = other
                    steps[n] = steps[i - 1] + 1 if second else 0
                    n += 1
    return reached


def _sampled(values: Voxels, at: FloatArray) -> FloatArray:
    """(n,) values at (n, 3) positions, by trilinear interpolation."""
    from scipy.ndimage import map_coordinates

    return np.asarray(map_coordinates(values, at.T, order=1), dtype=np.float64)
