"""Sets of voxels: their connected components, the distances to them, and the outside of a body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pcretrieve.arrays import FloatArray, Grid, Mask, bounds, joined_by, unit_vectors
from pcretrieve.values.compiled import compiled, inner

#: A quantity in each voxel.
Voxels: TypeAlias = NDArray[np.float32]

# Voxels are 26-adjacent if their centres are less than this apart: √3 < 1.8 < 2.
CORNER = 1.8


@compiled()
def components(
    voxels: Mask, corners: bool
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Label the connected components of a set of voxels, by runs along the last axis [1]_.

    scipy.ndimage.label gives the same labels and takes ten times longer.

    corners: whether voxels that have a corner in common are adjacent, or only those with a common face.
    Returns labels, sizes: number of the component of each voxel, from 1, in the order of their first voxels,
        0 outside the set; and number of voxels of each label.

    References
    ----------
    .. [1] L. He, Y. Chao and K. Suzuki, "A run-based two-scan labeling algorithm", IEEE Transactions on Image
       Processing 17 (2008).
    """
    n_x, n_y, _ = voxels.shape
    begins, ends, lines = _runs(voxels)
    parent = np.arange(len(begins))
    # The largest number of voxels from the end of a run to an adjacent run.
    apart = 0 if corners else -1
    for x in range(n_x):
        for y in range(n_y):
            line = x * n_y + y
            if y:
                _join(parent, begins, ends, lines, line, line - 1, apart)
            if x:
                for other in range(max(0, y - corners), min(n_y, y + corners + 1)):
                    _join(
                        parent, begins, ends, lines, line, line - n_y - y + other, apart
                    )
    label, n = _numbered(parent)
    labels = np.zeros(voxels.shape, dtype=np.int32)
    sizes = np.zeros(n + 1, dtype=np.int64)
    sizes[0] = voxels.size
    for line in range(n_x * n_y):
        here = labels[line // n_y, line % n_y]
        for run in range(lines[line], lines[line + 1]):
            here[begins[run] : ends[run]] = label[run]
            sizes[label[run]] += ends[run] - begins[run]
            sizes[0] -= ends[run] - begins[run]
    return labels, sizes


def touching(voxels: NDArray[Any]) -> NDArray[np.intp]:
    """(k,) number of the 26-connected component of each of (k, 3) voxels."""
    from scipy.spatial import cKDTree

    if not len(voxels):
        return np.zeros(0, dtype=np.intp)
    a, b = cKDTree(voxels).query_pairs(CORNER, output_type="ndarray").T
    return joined_by(a, b, len(voxels))


@inner()
def _runs(voxels: Mask) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int64]]:
    """First voxel and end of each run of voxels on each line, and the first run of each line."""
    n_x, n_y, n_z = voxels.shape
    lines = np.zeros(n_x * n_y + 1, dtype=np.int64)
    # Beginnings and ends in turn. There is room for all that may be; memory that is not used is not taken.
    limits = np.empty(voxels.size + n_x * n_y, dtype=np.int32)
    n = 0
    for line in range(n_x * n_y):
        here, inside = voxels[line // n_y, line % n_y], False
        for z in range(n_z):
            if here[z] != inside:
                inside = here[z]
                limits[n] = z
                n += 1
        if inside:
            limits[n] = n_z
            n += 1
        lines[line + 1] = n // 2
    return limits[0:n:2], limits[1:n:2], lines


@inner()
def _join(
    parent: NDArray[np.int64],
    begins: NDArray[np.int32],
    ends: NDArray[np.int32],
    lines: NDArray[np.int64],
    line: int,
    other: int,
    apart: int,
) -> None:
    """Join the runs of two adjacent lines that are adjacent."""
    a, b = lines[line], lines[other]
    while a < lines[line + 1] and b < lines[other + 1]:
        if begins[a] - ends[b] <= apart and begins[b] - ends[a] <= apart:
            one, two = _root(parent, a), _root(parent, b)
            parent[max(one, two)] = min(one, two)
        if ends[a] < ends[b]:
            a += 1
        else:
            b += 1


@inner()
def _root(parent: NDArray[np.int64], run: int) -> int:
    while parent[run] != run:
        parent[run] = parent[parent[run]]
        run = parent[run]
    return run


@inner()
def _numbered(parent: NDArray[np.int64]) -> tuple[NDArray[np.int32], int]:
    """The number of the component of each run, from 1; and how many there are."""
    label = np.zeros(len(parent), dtype=np.int32)
    n = 0
    for run in range(len(parent)):  # roots come before the runs that are joined to them
        root = _root(parent, run)
        if root == run:
            n += 1
            label[run] = n
        else:
            label[run] = label[root]
    return label, n


def distances(sources: Mask, limit: float) -> Voxels:
    """The Euclidean distance of each voxel to the nearest source voxel, at most `limit`, axis by axis [1]_.

    Squared distances along the last axis are exact, and each further axis takes the minimum over the
    neighbours on its lines. This is done for whole lines or planes, which are contiguous, so that it computes
    many voxels at once: twice as many if all sums of two squares have 16 bits.

    References
    ----------
    .. [1] T. Saito and J.-I. Toriwaki, "New algorithms for Euclidean distance transformation of an
       n-dimensional digitized picture with applications", Pattern Recognition 27 (1994).
    """
    n_x, n_y, n_z = sources.shape
    most = int(min(limit, n_x + n_y + n_z)) + 1
    squares = np.empty(sources.shape, np.uint16 if 2 * most**2 < 2**16 else np.uint32)
    _set_along_z(squares, sources, most)
    nothing = np.full(n_y * n_z, most**2, squares.dtype)
    _lower(squares, np.empty_like(squares[0]), nothing, most)
    planes = squares.reshape(1, n_x, n_y * n_z)
    _lower(planes, np.empty_like(planes[0]), nothing, most)
    roots: Voxels = np.sqrt(squares, dtype=np.float32)
    if limit > most:  # of voxels from which there is no source
        roots[squares == most**2] = limit
    np.minimum(roots, np.float32(limit), out=roots)
    return roots


@compiled()
def _set_along_z(squares: NDArray[Any], sources: Mask, most: int) -> None:
    """Set the squared distances along the last axis, most² where there is no source."""
    n_x, n_y, n_z = sources.shape
    for x in range(n_x):
        for y in range(n_y):
            line, here, away = squares[x, y], sources[x, y], most
            for z in range(n_z):
                away = 0 if here[z] else min(away + 1, most)
                line[z] = away
            for z in range(n_z - 1, -1, -1):
                away = min(np.int64(line[z]), away + 1)
                line[z] = away * away


@compiled()
def _lower(
    squares: NDArray[Any], lines: NDArray[Any], nothing: NDArray[Any], most: int
) -> None:
    """Lower the squares along the axis in the middle: to k² plus the square k voxels away, for all k.

    lines: as squares[0], for a copy. nothing: a line without a source.
    """
    n = squares.shape[1]
    for number in range(len(squares)):
        for i in range(n):
            for z in range(squares.shape[2]):
                lines[i, z] = squares[number, i, z]
        for i in range(n):
            line, largest, k = squares[number, i], squares.dtype.type(0), 1
            for z in range(len(line)):
                largest = max(largest, line[z])
            # A square that is less than k² cannot become smaller by a neighbour k voxels away.
            while k < min(most, n) and k * k < largest:
                before = lines[i - k] if i >= k else nothing
                after = lines[i + k] if i + k < n else nothing
                square = line.dtype.type(k * k)
                for z in range(len(line)):
                    line[z] = min(
                        line[z], line.dtype.type(min(before[z], after[z]) + square)
                    )
                k += 1


# --- the space outside a body ---------------------------------------------------------------------------

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
