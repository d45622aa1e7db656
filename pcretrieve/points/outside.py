"""The space outside a body, found by flood fill on a voxel grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcretrieve.arrays import bounds, unit_vectors
from pcretrieve.points.grid import Voxels, components, distances
from pcretrieve.values import FloatArray, Grid, Mask
from pcretrieve.values.compiled import compiled

# Number of empty voxels around the points, in which finite differences are computed.
MARGIN = 3

# Largest distance to the points that is measured; in voxels. No function uses larger ones.
FARTHEST = 12.0

# Smallest distance of the outside from every point; in voxels. Points that sample a surface with about one
# point in each voxel leave gaps, which this distance closes. It is small enough for the outside to reach
# between fingers.
CLEARANCE = 1.8


@dataclass(frozen=True, slots=True, eq=False)
class Outside:
    """The outside of a body: its voxels, the depth of each voxel below it, and the distance to the points."""

    grid: Grid
    reached: Mask
    depth: Voxels
    distance: Voxels

    def depth_at(self, points: FloatArray) -> FloatArray:
        """(n,) depths of points below the outside, by trilinear interpolation; in voxels."""
        return sampled(self.depth, self.grid.coordinates(points))

    def direction_at(self, points: FloatArray) -> FloatArray:
        """(n, 3) unit vectors in the direction of steepest descent of the depth; zero if there is none."""
        at = self.grid.coordinates(points)
        slope = np.empty((len(points), 3))
        for axis, step in enumerate(np.eye(3)):
            slope[:, axis] = sampled(self.depth, at - step) - sampled(
                self.depth, at + step
            )
        return unit_vectors(slope)


def flood(
    points: FloatArray,
    further: FloatArray | None = None,
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

    further: (k, 3), what the grid of the result shall contain beside the points.
    cell: edge of a voxel, about the spacing of the points.
    gap: radius of the largest hole that is closed; unit of the points.
    shift: as in `Grid.around`.
    deepest: largest depth below the outside that is measured; in voxels.
    """
    wall = gap / cell
    grid = Grid.around(points, cell, int(np.ceil(wall)) + MARGIN, shift)
    occupied = np.zeros(grid.shape, dtype=bool)
    occupied[grid.index(points)] = True
    distance = distances(occupied, max(FARTHEST, wall + MARGIN))
    labels, _ = components(distance > wall, corners=False)
    reached = labels == labels[0, 0, 0]
    del labels  # before further large arrays are made
    reached = _regrown(reached, distance, wall)
    # Around the points there is only outside, which later steps need not visit. All voxels `MARGIN` beyond
    # the points have been reached, so that none farther away is nearer to a voxel of the rest.
    held = points if further is None else np.concatenate([points, further])
    grid, rest = _around(held, grid)
    reached, distance = (
        np.ascontiguousarray(reached[rest]),
        np.ascontiguousarray(distance[rest]),
    )
    return Outside(grid, reached, distances(reached, deepest), distance)


def _around(points: FloatArray, grid: Grid) -> tuple[Grid, tuple[slice, ...]]:
    """The part of a grid that contains points, with a margin: the grid of this part, and its voxels."""
    at = grid.coordinates(np.array(bounds(points)))
    low = np.maximum(np.floor(at[0]).astype(int) - MARGIN, 0)
    high = np.minimum(np.ceil(at[1]).astype(int) + MARGIN + 1, grid.shape)
    a, b, c = (high - low).tolist()
    part = tuple(
        slice(first, last)
        for first, last in zip(low.tolist(), high.tolist(), strict=True)
    )
    return Grid(grid.origin + low * grid.cell, grid.cell, (a, b, c)), part


@compiled()
def _regrown(outside: Mask, distance: Voxels, wall: float) -> Mask:
    """The voxels outside the walls, and those reached from them by as many steps as the walls are thick."""
    result: Mask = outside.copy()
    reached, to_points = result.ravel(), distance.ravel()
    step = (outside.shape[1] * outside.shape[2], outside.shape[2], 1)
    front = np.empty(distance.size, dtype=np.int32)
    n = 0
    for cell in range(distance.size):
        # A voxel beside a wall; none is on the border of the grid.
        if reached[cell] and to_points[cell] <= wall + 1:
            front[n] = cell
            n += 1
    # Breadth-first search, one step for all voxels of the front at a time.
    begin = 0
    for _ in range(int(wall) + 1):
        end = n
        for i in range(begin, end):
            for axis in range(3):
                for other in (front[i] - step[axis], front[i] + step[axis]):
                    if not reached[other] and to_points[other] > CLEARANCE:
                        reached[other] = True
                        front[n] = other
                        n += 1
        begin = end
    return result


@compiled()
def sampled(values: Voxels, at: FloatArray) -> FloatArray:
    """(n,) values at (n, 3) positions in voxels, by trilinear interpolation between the centres of voxels.

    Positions outside the grid, whose sides have at least two voxels, are moved to its border.
    """
    found = np.empty(len(at))
    for i in range(len(at)):
        total = 0.0
        x = min(max(at[i, 0], 0.0), values.shape[0] - 1.0)
        y = min(max(at[i, 1], 0.0), values.shape[1] - 1.0)
        z = min(max(at[i, 2], 0.0), values.shape[2] - 1.0)
        u = min(int(x), values.shape[0] - 2)
        v = min(int(y), values.shape[1] - 2)
        w = min(int(z), values.shape[2] - 2)
        for a in range(2):
            for b in range(2):
                for c in range(2):
                    share = (
                        abs(1 - a - (x - u)) * abs(1 - b - (y - v)) * abs(1 - c - (z - w))
                    )
                    total += share * values[u + a, v + b, w + c]
        found[i] = total
    return found
