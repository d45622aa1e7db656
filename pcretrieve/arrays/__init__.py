"""The types of arrays, frames and grids of coordinates, and what several rooms compute of plain arrays."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

#: Real numbers in double precision: coordinates, eigenvalues, signatures.
FloatArray: TypeAlias = NDArray[np.float64]

#: Whole numbers of 32 bits: the vertex numbers of faces.
IntArray: TypeAlias = NDArray[np.int32]

#: Which of some elements are meant.
Mask: TypeAlias = NDArray[np.bool_]

#: The axes of files that may point upwards on pictures.
UPWARD = ("x", "-x", "y", "-y", "z", "-z")

# Largest distance of the middle of the points from the origin of their frame, in sizes of the frame: for
# computations in single and in double precision. In single precision a coordinate has 24 binary digits, all
# of which are needed to distinguish points. In double precision covariances are differences of mean squares,
# which lose 18 of their 53 binary digits at a distance of 512 sizes.
SINGLE_OFFSET = 0.5
DOUBLE_OFFSET = 512.0


class Frame(NamedTuple):
    """The coordinates (x − origin) / size, in which the points have a diagonal between 1/2 and 1.

    The size is a power of two, and the origin is a multiple of it. For points around the origin of the
    caller, the origin is zero, and both transformations are exact.

    origin: (3,) float64, unit of the caller.
    """

    origin: FloatArray
    size: float

    @classmethod
    def around(cls, points: FloatArray, *, offset: float = SINGLE_OFFSET) -> Frame:
        """The frame of points (n, 3); of unit size if there are no points, or all points are equal."""
        if not len(points):
            return cls(np.zeros(3), 1.0)
        size = power_of_two(bounding_diagonal(points))
        step = 2 * offset * size
        return cls(np.round(sum(bounds(points)) / 2 / step) * step, size)

    def inward(self, points: FloatArray) -> FloatArray:
        """The coordinates (n, 3) of points of the caller in this frame."""
        return (points - self.origin) / self.size

    def outward(self, points: FloatArray) -> FloatArray:
        """The coordinates (n, 3) of points in this frame in the unit of the caller."""
        return points * self.size + self.origin


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """A grid of cubic voxels of the edge `cell`. The coordinates of a voxel are those of its centre.

    origin: (3,) float64, centre of voxel (0, 0, 0); unit of the file.
    """

    origin: FloatArray
    cell: float
    shape: tuple[int, int, int]

    @classmethod
    def around(
        cls, points: FloatArray, cell: float, margin: int, shift: FloatArray | float = 0.0
    ) -> Grid:
        """The smallest grid that contains points and a margin.

        shift: (3,) float64 or float, displacement of the grid in the negative directions; in voxels.
        """
        low, high = bounds(points)
        low = low - np.asarray(shift) * cell
        n_x, n_y, n_z = (
            np.ceil((high - low) / cell).astype(int) + 2 * margin + 1
        ).tolist()
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


def bounds(points: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """(3,) the least and (3,) the greatest coordinates of points (n, 3), of which there is one at least."""
    # Column by column: along the first axis of short rows, NumPy takes twenty times as long.
    return np.array([x.min() for x in points.T]), np.array([x.max() for x in points.T])


def bounding_diagonal(points: FloatArray) -> float:
    """Diagonal of the axis-aligned bounding box of points (n, 3); 0 if there are none."""
    return float(np.linalg.norm(np.subtract(*bounds(points)))) if len(points) else 0.0


def power_of_two(length: float) -> float:
    """The least power of two above a length."""
    return math.ldexp(1.0, math.frexp(length)[1])


def unit_vectors(vectors: NDArray[Any]) -> FloatArray:
    """Vectors (…, d) divided by their lengths; zero vectors are not changed."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > 0, length, 1)


def tangent_axes(normals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two orthogonal unit vectors (…, 3) that are perpendicular to each unit normal (…, 3)."""
    # The axis that is farthest from the normal, made orthogonal to it.
    farthest = np.eye(3)[np.abs(normals).argmin(axis=-1)]
    first = unit_vectors(np.cross(normals, farthest))
    return first, np.cross(normals, first)


def area_vectors(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """(m, 3) the normals of faces, by their orientation, with the area as the length."""
    # Columns, which are contiguous, are multiplied three times as fast as rows.
    a, b, c = (vertices.T.take(corner, axis=1) for corner in faces.T)
    return np.ascontiguousarray(np.cross(b - a, c - a, axis=0).T) / 2


def vertex_normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """(n, 3) unit normals: of the sum of the area vectors of the faces of a vertex; zero where that is."""
    vectors = np.repeat(area_vectors(vertices, faces), 3, axis=0)
    sums = [
        np.bincount(faces.ravel(), each, minlength=len(vertices)) for each in vectors.T
    ]
    return unit_vectors(np.transpose(sums))


def joined_by(a: NDArray[np.integer], b: NDArray[np.integer], n: int) -> NDArray[np.intp]:
    """(n,) classes of the equivalence relation of n elements that pairs a[i], b[i] of one class generate.

    They are the connected components of a graph, and numbered in the order of their first elements.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(a), dtype=np.int8), (a, b)), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.intp)


def grid_points(corners: FloatArray, n: int) -> FloatArray:
    """(k, 3) points of regular grids on triangles, whose corners are (f, 3, 3), n steps along each side."""
    i, j = np.nonzero(np.add.outer(np.arange(n + 1), np.arange(n + 1)) <= n)
    shares = np.column_stack([i, j, n - i - j]) / n  # (g, 3): barycentric coordinates
    return np.asarray(np.einsum("gk,fkd->fgd", shares, corners).reshape(-1, 3))
