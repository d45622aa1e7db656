"""Depth pictures of a surface from 66 directions, and the rotations that exchange the directions."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from itertools import permutations, product

import numpy as np
from numba import njit

from pcretrieve.values import FloatArray, IntArray, TriangleMesh

__all__ = ["depth_pictures", "directions", "exchanges"]

# Side of the pictures in pixels. See docs/decisions.md, VOCABULARY.
N_PIXELS = 128

# Margin on each side of a picture, relative to half of its width.
MARGIN = 0.05


@cache
def directions() -> FloatArray:
    """(66, 3) unit vectors: the vertices of the octahedron whose faces are cut in four twice."""
    points = [np.array(p) for p in product(range(-4, 5), repeat=3) if np.abs(p).sum() == 4]
    # A subdivision moves the midpoints of edges to the sphere: the grid on a face of the octahedron, in which
    # every second vertex is of the first subdivision.
    return np.array([_subdivided(point) for point in points])


def _subdivided(point: IntArray) -> FloatArray:
    """The vertex on the unit sphere at a grid point (a, b, c) of the octahedron |a| + |b| + |c| = 4."""
    if not point.astype(int).any() or (point % 4 == 0).all():
        return np.asarray(point / 4.0)
    step = 2 if (point % 2 == 0).all() else 1
    # The ends of the edge whose midpoint this is: two of the coordinates differ by one step.
    odd = [axis for axis in range(3) if (point[axis] // step) % 2]
    move = np.zeros(3, dtype=int)
    move[odd[0]] = step if point[odd[0]] > 0 else -step
    move[odd[1]] = -step if point[odd[1]] > 0 else step
    middle = _subdivided(point + move) + _subdivided(point - move)
    return np.asarray(middle / np.linalg.norm(middle))


@cache
def exchanges() -> IntArray:
    """What the 24 rotations of an octahedron do to the directions.

    Returns (24, 66) int32: the number of the direction to which each rotation turns each direction. The
        identity is among them.
    """
    views = directions()
    rows = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            if np.linalg.det(matrix) > 0:
                rows.append((views @ matrix.T @ views.T).argmax(axis=1))
    return np.array(rows, dtype=np.int32)


def depth_pictures(mesh: TriangleMesh) -> Iterator[FloatArray]:
    """Depth pictures of a surface from all directions, by orthographic projection.

    mesh: within the unit sphere.
    Yields (128, 128) float64: for each of `directions`: (1 + z) / 2 at the point nearest to the camera, with
        z the coordinate towards the camera; 0 where there is no surface.
    """
    scale = (1 - MARGIN) * (N_PIXELS - 1) / 2
    for towards in directions():
        seen = mesh.vertices @ _camera(towards).T  # (n, 3)
        pixels = np.column_stack([seen[:, :2] * scale + (N_PIXELS - 1) / 2, (1 + seen[:, 2]) / 2])
        yield _drawn(pixels, mesh.faces, N_PIXELS)


def _camera(towards: FloatArray) -> FloatArray:
    """(3, 3) orthonormal rows: to the right, upwards, and the given direction, towards the camera."""
    upright = np.eye(3)[2] if abs(towards[2]) < 1 - 1e-9 else np.eye(3)[1]
    right = np.cross(upright, towards)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(towards, right), towards])


@njit(cache=True)
def _drawn(pixels: FloatArray, faces: IntArray, side: int) -> FloatArray:
    """A picture (side, side) of the largest third coordinate at each pixel (x, y), and 0 without a face."""
    picture = np.zeros((side, side))
    for face in range(len(faces)):
        x0, y0, z0 = pixels[faces[face, 0]]
        x1, y1, z1 = pixels[faces[face, 1]]
        x2, y2, z2 = pixels[faces[face, 2]]
        double = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if abs(double) < 1e-12:  # seen from its edge
            continue
        for y in range(max(0, int(np.ceil(min(y0, y1, y2)))), min(side - 1, int(max(y0, y1, y2))) + 1):
            for x in range(max(0, int(np.ceil(min(x0, x1, x2)))), min(side - 1, int(max(x0, x1, x2))) + 1):
                a = ((x - x0) * (y2 - y0) - (x2 - x0) * (y - y0)) / double
                b = ((x1 - x0) * (y - y0) - (x - x0) * (y1 - y0)) / double
                # A pixel on an edge is in both faces, in spite of rounding.
                if a >= -1e-9 and b >= -1e-9 and a + b <= 1 + 1e-9:
                    picture[y, x] = max(picture[y, x], z0 + a * (z1 - z0) + b * (z2 - z0))
    return picture
