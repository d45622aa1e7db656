"""Grids of cubic voxels, and arrays with one value for each voxel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from pcretrieve.values import FloatArray, TriangleMesh

#: A set of voxels, or of other elements.
Mask: TypeAlias = NDArray[np.bool_]

#: A quantity in each voxel.
Voxels: TypeAlias = NDArray[np.float32]

# Voxels are 26-adjacent if their centres are less than this apart: √3 < 1.8 < 2.
CORNER = 1.8


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """A grid of cubic voxels of the edge `cell`. The coordinates of a voxel are those of its centre.

    origin: (3,) float64, centre of voxel (0, 0, 0); unit of the file.
    """

    origin: FloatArray
    cell: float
    shape: tuple[int, int, int]

    @classmethod
    def around(cls, points: FloatArray, cell: float, margin: int, shift: FloatArray | float = 0.0) -> Grid:
        """The smallest grid that contains points and a margin.

        shift: (3,) float64 or float, displacement of the grid in the negative directions; in voxels.
        """
        low, high = points.min(axis=0) - np.asarray(shift) * cell, points.max(axis=0)
        n_x, n_y, n_z = (np.ceil((high - low) / cell).astype(int) + 2 * margin + 1).tolist()
        return cls(low - margin * cell, cell, (n_x, n_y, n_z))

    def coordinates(self, points: FloatArray) -> FloatArray:
        """(n, 3) coordinates of points in voxels, integer at the centres."""
        return (points - self.origin) / self.cell

    def centres(self, at: NDArray[Any]) -> FloatArray:
        """(n, 3) points at coordinates in voxels."""
        return np.asarray(at * self.cell + self.origin, dtype=np.float64)

    def index(self, points: FloatArray) -> tuple[NDArray[np.intp], ...]:
        """Indices, for an array of `shape`, of the voxels that contain the points."""
        return tuple(np.rint(self.coordinates(points)).astype(np.intp).T)


@njit(cache=True)
def components(voxels: Mask, corners: bool) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
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
    apart = 0 if corners else -1  # the largest number of voxels from the end of a run to an adjacent run
    for x in range(n_x):
        for y in range(n_y):
            line = x * n_y + y
            if y:
                _join(parent, begins, ends, lines, line, line - 1, apart)
            if x:
                for other in range(max(0, y - corners), min(n_y, y + corners + 1)):
                    _join(parent, begins, ends, lines, line, line - n_y - y + other, apart)
    label = np.zeros(len(begins), dtype=np.int32)
    n = 0
    for run in range(len(begins)):  # roots come before the runs that are joined to them
        root = _root(parent, run)
        if root == run:
            n += 1
            label[run] = n
        else:
            label[run] = label[root]
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


def joined_by(a: NDArray[np.integer], b: NDArray[np.integer], n: int) -> NDArray[np.intp]:
    """(n,) classes of the equivalence relation of n elements that pairs a[i], b[i] of one class generate.

    They are the connected components of a graph, and numbered in the order of their first elements.
    """
    graph = coo_array((np.ones(len(a), dtype=np.int8), (a, b)), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.intp)


@njit(cache=True)
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


@njit(cache=True)
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


@njit(cache=True)
def _root(parent: NDArray[np.int64], run: int) -> int:
    while parent[run] != run:
        parent[run] = parent[parent[run]]
        run = parent[run]
    return run


# The squared distance of a voxel that no source has reached yet; in voxels².
FAR = np.float32(1e18)


@njit(cache=True)
def distances(sources: Mask, limit: float) -> Voxels:
    """The Euclidean distance of each voxel to the nearest source voxel, at most `limit`, axis by axis [1]_.

    Distances along the second axis are exact squares, and each further axis takes the minimum over the
    neighbours on its lines. All loops are over lines of the last axis, which are contiguous, so that they
    compute eight voxels at once; lines that are beyond the limit are skipped.

    References
    ----------
    .. [1] T. Saito and J.-I. Toriwaki, "New algorithms for Euclidean distance transformation of an
       n-dimensional digitized picture with applications", Pattern Recognition 27 (1994).
    """
    n_x, n_y, n_z = sources.shape
    reach = int(min(limit, max(n_x, n_y, n_z))) + 1
    squares, largest, is_near = _squares_along_y(sources, min(limit * limit, FAR))
    result = np.full(sources.shape, limit, dtype=np.float32)
    for x in range(n_x):
        for y in range(n_y):
            line = squares[x, y].copy()  # numba compiles an assignment of an array for seconds
            is_reached = is_near[x, y]
            k = 1
            # A square that is less than k² cannot become smaller by a neighbour k voxels away.
            while k <= reach and k * k < largest[x, y]:
                if x >= k and is_near[x - k, y]:
                    _lower(line, squares[x - k, y], k)
                    is_reached = True
                if x + k < n_x and is_near[x + k, y]:
                    _lower(line, squares[x + k, y], k)
                    is_reached = True
                k += 1
            if not is_reached:
                continue
            best, deepest = result[x, y], np.float32(0)
            for z in range(n_z):
                best[z] = line[z]
                deepest = max(deepest, line[z])
            k = 1
            while k <= reach and k < n_z and k * k < deepest:
                _lower(best[: n_z - k], line[k:], k)
                _lower(best[k:], line[: n_z - k], k)
                k += 1
            for z in range(n_z):
                best[z] = min(np.sqrt(best[z]), np.float32(limit))
    return result


@njit(cache=True)
def _squares_along_y(sources: Mask, most: float) -> tuple[Voxels, Voxels, Mask]:
    """Squared distances along the second axis; of each line, the largest, and whether any is below `most`."""
    n_x, n_y, n_z = sources.shape
    squares = np.empty(sources.shape, dtype=np.float32)
    largest = np.empty((n_x, n_y), dtype=np.float32)
    is_near = np.empty((n_x, n_y), dtype=np.bool_)
    for x in range(n_x):
        for y in range(n_y):
            line, here = squares[x, y], sources[x, y]
            before = squares[x, max(0, y - 1)]
            for z in range(n_z):
                step = before[z] + np.float32(1) if y else FAR
                line[z] = np.float32(0) if here[z] else step
        for y in range(n_y - 2, -1, -1):
            line, after = squares[x, y], squares[x, y + 1]
            for z in range(n_z):
                line[z] = min(line[z], after[z] + np.float32(1))
        for y in range(n_y):
            line, highest, lowest = squares[x, y], np.float32(0), FAR
            for z in range(n_z):
                line[z] = min(line[z] * line[z], FAR)
                highest, lowest = max(highest, line[z]), min(lowest, line[z])
            largest[x, y], is_near[x, y] = highest, lowest < most
    return squares, largest, is_near


@njit(cache=True)
def _lower(line: Voxels, other: Voxels, k: int) -> None:
    """Lower the squares of a line to those of another line, k voxels away, plus k²."""
    square = np.float32(k * k)
    for z in range(len(line)):
        line[z] = min(line[z], other[z] + square)


# Displacement of the grid lines along each axis, in voxels, that keeps them off the vertices and edges of
# surfaces that are aligned with the grid, where a crossing would be counted twice or not at all.
DISPLACEMENT = (1.3e-7, 2.1e-7, 0.7e-7)


def interior(mesh: TriangleMesh, grid: Grid) -> Mask:
    """The voxels whose centres are inside a surface.

    Along each of the three axes, the winding number of the surface round a voxel is the sum of the
    orientations of the triangles that the grid line crosses before the voxel [1]_. A voxel is inside if the
    winding number is not zero along two axes or three, so that a hole of an open surface is closed where the
    lines along the two other axes do not pass through it.

    References
    ----------
    .. [1] F. Nooruddin and G. Turk, "Simplification and repair of polygonal models using volumetric
       techniques", IEEE Transactions on Visualization and Computer Graphics 9 (2003).
    """
    at = grid.coordinates(mesh.vertices) + DISPLACEMENT
    triangles = at[mesh.faces]  # (m, 3, 3)
    votes = np.zeros(grid.shape, dtype=np.int8)
    for axis in range(3):
        order = [*(other for other in range(3) if other != axis), axis]
        turned = _winding(triangles[:, :, order], tuple(grid.shape[other] for other in order))
        votes += np.transpose(turned != 0, np.argsort(order))
    return votes >= 2


def _winding(triangles: NDArray[np.float64], shape: tuple[int, ...]) -> NDArray[np.int32]:
    """Winding numbers of triangles (m, 3, 3) round the voxels of a grid, along the last axis."""
    plane = triangles[:, :, :2]  # (m, 3, 2)
    first = np.ceil(plane.min(axis=1)).astype(np.intp)  # (m, 2): the grid lines in the bounding rectangle
    count = np.maximum(np.floor(plane.max(axis=1)).astype(np.intp) - first + 1, 0)
    n_lines = count.prod(axis=1)
    face = np.repeat(np.arange(len(triangles)), n_lines)  # (c,): one row for each pair of face and line
    number = np.arange(len(face)) - np.repeat(np.cumsum(n_lines) - n_lines, n_lines)
    rows, columns = np.divmod(number, count[face, 1])
    line = first[face] + np.column_stack([rows, columns])  # (c, 2)
    corners = plane[face] - line[:, np.newaxis]  # (c, 3, 2)
    after, last = corners[:, [1, 2, 0]], corners[:, [2, 0, 1]]
    # Twice the signed areas of the triangles of the line and one edge, the edge opposite each corner.
    parts = after[:, :, 0] * last[:, :, 1] - after[:, :, 1] * last[:, :, 0]  # (c, 3)
    crossed = (parts > 0).all(axis=1) | (parts < 0).all(axis=1)
    face, line, parts = face[crossed], line[crossed], parts[crossed]
    total = parts.sum(axis=1)
    height = (parts * triangles[face, :, 2]).sum(axis=1) / total
    crossings = np.zeros((shape[0], shape[1], shape[2] + 1), dtype=np.int32)
    np.add.at(crossings, (*line.T, np.ceil(height).astype(np.intp)), np.sign(total).astype(np.int32))
    return np.asarray(np.cumsum(crossings, axis=2, dtype=np.int32)[:, :, :-1])
