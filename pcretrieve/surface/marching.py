"""Cells of a body → triangles: marching cubes whose surface is a closed manifold for every set of cells."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.types import FloatArray, IntArray

__all__ = ["Crossings", "crossed", "marched"]


class Crossings(NamedTuple):
    """Where a surface crosses lines from the centre of a cell to the next along one axis.

    Attributes
    ----------
    at : (k, 3) intp
        The cells, as `crossed` gives them.
    share : (k,) float64, or float for all
        Of the way to the next centre.
    """

    at: NDArray[np.intp]
    share: FloatArray | float


# Corner k of a cube has the bits of k as its coordinates.
CORNERS = np.array([[k >> 2 & 1, k >> 1 & 1, k & 1] for k in range(8)])
EDGES = [(a, b) for a in range(8) for b in range(a + 1, 8) if (a ^ b).bit_count() == 1]
NUMBER = {frozenset(edge): k for k, edge in enumerate(EDGES)}

# Cubes all of whose corners but two opposite ones are in the body.
TUBES = {255 ^ (1 << k | 1 << (7 - k)) for k in range(4)}

# Loops of this length and more get a vertex in their middle. A shorter loop meets no face of its cube twice,
# so that no diagonal of it can lie in a face and coincide with a diagonal of the next cube.
LONG = 6


def marched(body: NDArray[np.bool_], crossings: Sequence[Crossings] = ()) -> tuple[FloatArray, IntArray]:
    """The surface between the cells of a body and the others [1]_.

    Cells of the body are connected through their faces, cells outside through faces, edges and corners: a
    face of a cube with two opposite corners in the body separates them, and two opposite corners of a cube
    that alone are outside are connected. With these rules the surface is closed and manifold, and has the
    topology of the body's boundary, for every set of cells.

    Parameters
    ----------
    body : (a, b, c) bool
        False on the border of the grid.
    crossings : sequence of Crossings, optional
        Where the surface crosses the lines of `crossed` along each axis, between 0 and 1; by default, in the
        middle.

    Returns
    -------
    vertices : (n, 3) float64
        In cells; the first of them, in the order of `crossed`, lie on lines between centres.
    faces : (m, 3) int32
        Counter-clockwise seen from outside.

    References
    ----------
    .. [1] Lorensen and Cline, "Marching cubes", SIGGRAPH 1987, with the ambiguous faces decided as in
       Kong and Rosenfeld, "Digital topology: introduction and survey", 1989, for (6, 26)-adjacency.
    """
    number = np.empty((3, *body.shape), dtype=np.int32)  # of the vertex on each line that is crossed
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
            """(g,) the vertex on an edge of each cube."""
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
    """For each axis, the cells whose line to the next cell along it leaves or enters the body, (k, 3)."""
    found = []
    for axis in range(3):
        here = [slice(None)] * 3
        after = [slice(None)] * 3
        here[axis], after[axis] = slice(None, -1), slice(1, None)
        found.append(np.argwhere(body[tuple(here)] != body[tuple(after)]))
    return found


@cache
def _loops(case: int) -> list[list[int]]:
    """Closed rings of crossed edges of a cube whose corners in the body are the bits of `case`.

    Each ring is counter-clockwise seen from outside the body.
    """
    inside = [bool(case >> k & 1) for k in range(8)]
    follows: dict[int, int] = {}
    for ring in _cube_faces():
        for s in range(4):
            first, last = ring[s], ring[(s + 1) % 4]
            if inside[first] or not inside[last]:
                continue
            # A run of corners in the body starts here; the surface cuts it off, and no other run with it.
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
    """Triangles, as edges of the cube, between the loops round two opposite corners outside the body.

    Cells that share a corner are connected outside the body, so that the loops are the ends of a tube.
    """
    ends = _loops(case)
    triangles = []
    for loop, other in (ends, ends[::-1]):
        for first, last in zip(loop, loop[1:] + loop[:1], strict=True):
            # The corner of the body that both edges see: it is next to the other end's corner.
            corners = [*EDGES[first], *EDGES[last]]
            outer = max(corners, key=corners.count)
            across = outer ^ (EDGES[first][0] ^ EDGES[first][1]) ^ (EDGES[last][0] ^ EDGES[last][1])
            triangles.append([first, last, next(edge for edge in other if across in EDGES[edge])])
    return triangles


@cache
def _cube_faces() -> list[list[int]]:
    """Corners of each face of a cube, counter-clockwise seen from outside the cube."""
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
