"""A set of voxels → triangulated surface: marching cubes with a closed manifold for every set of voxels."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.types import FloatArray, IntArray

__all__ = ["Crossings", "crossed", "marched"]


class Crossings(NamedTuple):
    """Where a surface crosses the links from a voxel to the next along one axis.

    Attributes
    ----------
    at : (k, 3) intp
        The voxels at which the links begin, from `crossed`.
    share : (k,) float64, or float for all
        Position of the crossing, as a fraction of the link.
    """

    at: NDArray[np.intp]
    share: FloatArray | float


# A cube has the centres of eight voxels as its corners. The coordinates of corner k are the bits of k.
CORNERS = np.array([[k >> 2 & 1, k >> 1 & 1, k & 1] for k in range(8)])
EDGES = [(a, b) for a in range(8) for b in range(a + 1, 8) if (a ^ b).bit_count() == 1]
NUMBER = {frozenset(edge): k for k, edge in enumerate(EDGES)}

# Cubes with all corners in the body except two opposite ones.
TUBES = {255 ^ (1 << k | 1 << (7 - k)) for k in range(4)}

# Loops of at least this length are triangulated with a vertex in their middle. A
# shorter loop crosses no face of its cube twice, so that none of its diagonals lies
# in a face and coincides with a diagonal of the adjacent cube.
LONG = 6


def marched(body: NDArray[np.bool_], crossings: Sequence[Crossings] = ()) -> tuple[FloatArray, IntArray]:
    """The boundary surface of a set of voxels, by marching cubes [1]_.

    The set is 6-connected and its complement 26-connected. Hence, on a face of a cube with two opposite
    corners in the set, these corners are separated; and two opposite corners of a cube that are its only ones
    outside are connected through the cube. With these rules the surface is closed and manifold, and has the
    topology of the boundary, for every set of voxels.

    Parameters
    ----------
    body : (a, b, c) bool
        The set; False on the border of the grid.
    crossings : sequence of Crossings, length 3, optional
        Where the surface crosses the links of `crossed` along each axis, between 0 and 1. By default in the
        middle.

    Returns
    -------
    vertices : (n, 3) float64
        Coordinates, in voxels. The vertices on links come first, in the order of `crossed`.
    faces : (m, 3) int32
        Vertex numbers, counter-clockwise seen from outside.

    References
    ----------
    .. [1] Lorensen and Cline, "Marching cubes", SIGGRAPH 1987, with the ambiguous faces decided as in
       Kong and Rosenfeld, "Digital topology: introduction and survey", 1989, for (6, 26)-adjacency.
    """
    number = np.empty((3, *body.shape), dtype=np.int32)  # of the vertex on each crossed link
    placed = []
    n = 0
    for axis, (at, share) in enumerate(crossings or [Crossings(at, 0.5) for at in crossed(body)]):
        number[axis][tuple(at.T)] = np.arange(n, n + len(at))
        n += len(at)
        position = at.astype(np.float64)
        position[:, axis] += share
        placed.append(position)
    vertices = np.concatenate(placed)

    a, b, c = (size - 1 for size in body.shape)
    case = np.zeros((a, b, c), dtype=np.uint8)
    for k, (x, y, z) in enumerate(CORNERS):
        case |= body[x : a + x, y : b + y, z : c + z].astype(np.uint8) << np.uint8(k)
    cubes = np.argwhere((case > 0) & (case < 255))
    cases = case[tuple(cubes.T)]
    order = np.argsort(cases, kind="stable")
    ends = np.searchsorted(cases[order], np.arange(257))
    faces, middles = [], []
    for k in range(1, 255):
        group = cubes[order[ends[k] : ends[k + 1]]]  # (g, 3)
        if not len(group):
            continue

        def vertex(edge: int, group: NDArray[np.intp] = group) -> IntArray:
            """(g,) vertex on an edge of each cube of the group."""
            low, high = EDGES[edge]
            axis = int((CORNERS[high] - CORNERS[low]).argmax())
            return np.asarray(number[axis][tuple((group + CORNERS[low]).T)])

        if k in TUBES:
            faces += [np.stack([vertex(edge) for edge in triangle], axis=1) for triangle in _tube(k)]
            continue
        for loop in _loops(k):
            ring = np.stack([vertex(edge) for edge in loop], axis=1)  # (g, length)
            if len(loop) < LONG:
                faces += [ring[:, [0, i, i + 1]] for i in range(1, len(loop) - 1)]
            else:
                middle = np.arange(n, n + len(group), dtype=np.int32)
                n += len(group)
                middles.append(vertices[ring].mean(axis=1))
                after = np.roll(ring, -1, axis=1)
                faces += [np.stack([ring[:, i], after[:, i], middle], axis=1) for i in range(len(loop))]
    return np.concatenate([vertices, *middles]), np.concatenate(faces).astype(np.int32)


def crossed(body: NDArray[np.bool_]) -> list[NDArray[np.intp]]:
    """The links between adjacent voxels of which one is in a set and the other is not.

    Parameters
    ----------
    body : (a, b, c) bool
        The set of voxels.

    Returns
    -------
    list of (k, 3) int, length 3
        For each axis, the voxels at which these links begin.
    """
    found = []
    for axis in range(3):
        here = [slice(None)] * 3
        after = [slice(None)] * 3
        here[axis], after[axis] = slice(None, -1), slice(1, None)
        found.append(np.argwhere(body[tuple(here)] != body[tuple(after)]))
    return found


@cache
def _loops(case: int) -> list[list[int]]:
    """Loops of crossed edges, counter-clockwise seen from outside, for the inner corners `case`."""
    inside = [bool(case >> k & 1) for k in range(8)]
    follows: dict[int, int] = {}
    for ring in _cube_faces():
        for s in range(4):
            first, last = ring[s], ring[(s + 1) % 4]
            if inside[first] or not inside[last]:
                continue
            # A run of corners in the set begins here. The surface separates it from the other corners.
            t = s + 1
            while inside[ring[(t + 1) % 4]]:
                t += 1
            leaves = NUMBER[frozenset((ring[t % 4], ring[(t + 1) % 4]))]
            follows[NUMBER[frozenset((first, last))]] = leaves
    loops = []
    while follows:
        start, edge = follows.popitem()
        loop = [start]
        while edge != start:
            loop.append(edge)
            edge = follows.pop(edge)
        loops.append(loop)
    return loops


@cache
def _tube(case: int) -> list[list[int]]:
    """Triangles, as edges of the cube, of the tube between the loops around two opposite outer corners."""
    ends = _loops(case)
    triangles = []
    for loop, other in (ends, ends[::-1]):
        for first, last in zip(loop, loop[1:] + loop[:1], strict=True):
            # The corner that both edges have in common is adjacent to the corner at
            # the other end of the tube.
            corners = [*EDGES[first], *EDGES[last]]
            outer = max(corners, key=corners.count)
            across = outer ^ (EDGES[first][0] ^ EDGES[first][1]) ^ (EDGES[last][0] ^ EDGES[last][1])
            triangles.append([first, last, next(edge for edge in other if across in EDGES[edge])])
    return triangles


@cache
def _cube_faces() -> list[list[int]]:
    """The corners of each face of a cube, counter-clockwise seen from outside the cube."""
    faces = []
    for axis in range(3):
        for side in (0, 1):
            ring = []
            for u, v in ((0, 0), (1, 0), (1, 1), (0, 1)):
                corner = [0, 0, 0]
                corner[axis], corner[(axis + 1) % 3], corner[(axis + 2) % 3] = side, u, v
                ring.append(corner[0] * 4 + corner[1] * 2 + corner[2])
            faces.append(ring if side else ring[::-1])
    return faces
