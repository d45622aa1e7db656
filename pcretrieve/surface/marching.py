"""A set of voxels → triangulated surface: marching cubes with a closed manifold for every set of voxels."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.values import FloatArray, IntArray, Mask
from pcretrieve.values.compiled import compiled, inner


class Crossings(NamedTuple):
    """Where a surface crosses the links from (k, 3) voxels to the next along an axis, as a share of them."""

    at: NDArray[np.intp]
    share: FloatArray | float


# A cube has the centres of eight voxels as its corners. The coordinates of corner k are the bits of k.
CORNERS = np.array([[k >> 2 & 1, k >> 1 & 1, k & 1] for k in range(8)])
EDGES = [(a, b) for a in range(8) for b in range(a + 1, 8) if (a ^ b).bit_count() == 1]
NUMBER = {frozenset(edge): k for k, edge in enumerate(EDGES)}

# Cubes with all corners in the body except two opposite ones.
TUBES = {255 ^ (1 << k | 1 << (7 - k)) for k in range(4)}

# Loops of at least this length are triangulated with a vertex in their middle. A shorter loop crosses no face
# of its cube twice, so that none of its diagonals lies in a face and coincides with one of the adjacent cube.
LONG = 6

# The number of such a vertex among those of a cube, after the vertices on its twelve edges. No cube has two.
MIDDLE = 12

# Largest number of triangles in a cube, and largest length of a loop.
MOST = 7

# Smallest distance of a vertex from the ends of its link, relative to the link: no triangle is degenerate.
LEAST_SHARE = 0.02

# The corner at the lower end of each edge, and the axis along which the edge is.
LOWER = np.array([CORNERS[low] for low, _ in EDGES])  # (12, 3)
AXIS = np.array(
    [int((CORNERS[high] - CORNERS[low]).argmax()) for low, high in EDGES]
)  # (12,)


def level_set(values: NDArray[np.floating], level: float) -> tuple[FloatArray, IntArray]:
    """The surface, as `marched` gives it, round the voxels above a level, at linearly interpolated places."""
    crossings = []
    for axis, low in enumerate(crossed(values > level)):
        near, far = (
            values[tuple(low.T)],
            values[tuple((low + np.eye(3, dtype=np.intp)[axis]).T)],
        )
        crossings.append(
            Crossings(
                low, np.clip((level - near) / (far - near), LEAST_SHARE, 1 - LEAST_SHARE)
            )
        )
    return marched(values > level, crossings)


def marched(
    body: Mask, crossings: Sequence[Crossings] = ()
) -> tuple[FloatArray, IntArray]:
    """The boundary surface of a set of voxels, by marching cubes [1]_.

    The set is 6-connected and its complement 26-connected. Hence, on a face of a cube with two opposite
    corners in the set, these corners are separated; and two opposite corners of a cube that are its only ones
    outside are connected through the cube. With these rules the surface is closed and manifold, and has the
    topology of the boundary, for every set of voxels.

    body: the set; False on the border of the grid.
    crossings: for each axis, the voxels from `crossed`; by default in the middle of the links.
    Returns vertices, faces: coordinates, in voxels, first of the vertices on links, in the order of
        `crossed`; and vertex numbers, counter-clockwise seen from outside.

    References
    ----------
    .. [1] Lorensen and Cline, "Marching cubes", SIGGRAPH 1987, with the ambiguous faces decided as in
       Kong and Rosenfeld, "Digital topology: introduction and survey", 1989, for (6, 26)-adjacency.
    """
    links, placed = [], []
    for axis, (at, share) in enumerate(
        crossings or [Crossings(at, 0.5) for at in crossed(body)]
    ):
        links.append(at)
        placed.append(at.astype(np.float64))
        placed[axis][:, axis] += share
    vertices = np.concatenate(placed)
    faces, middles = _triangulated(body, tuple(links), vertices, _table())
    return np.concatenate([vertices, middles]), faces


class Table(NamedTuple):
    """What each of the 256 cases of a cube has, by edges of the cube; −1 for none.

    triangles: (256, 7, 3), with `MIDDLE` for a vertex in the middle of a loop; and n_triangles: (256,).
    loops: (256, 7), the loop round that vertex.
    """

    triangles: IntArray
    n_triangles: IntArray
    loops: IntArray


@compiled()
def _triangulated(
    body: Mask, links: tuple[NDArray[np.intp], ...], vertices: FloatArray, table: Table
) -> tuple[IntArray, FloatArray]:
    """The (m, 3) faces, sorted by the case of their cubes, and the (k, 3) vertices in the middle of loops."""
    cases, n_cubes = _cases(body)
    first_face, first_middle = _firsts(n_cubes, table)
    faces = np.empty((first_face[256], 3), dtype=np.int32)
    middles = np.zeros((first_middle[256], 3))
    done = np.zeros(256, dtype=np.int64)
    corner = np.empty(MIDDLE + 1, dtype=np.int32)  # vertices of the cube
    # The numbers of the vertices on the links from the voxels of the layers x and x + 1.
    number = np.empty((3, 2, body.shape[1], body.shape[2]), dtype=np.int32)
    begin = np.zeros(3, dtype=np.int64)
    _number_layer(number, links, begin, 0)
    for x in range(cases.shape[0]):
        _number_layer(number, links, begin, x + 1)
        for y in range(cases.shape[1]):
            for z in range(cases.shape[2]):
                case = cases[x, y, z]
                if table.n_triangles[case] == 0:
                    continue
                _set_corners(corner, table, case, number, x, y, z)
                middle = first_middle[case] + done[case]
                if table.loops[case, 0] >= 0:
                    _set_middle(middles[middle], vertices, corner, table.loops[case])
                    corner[MIDDLE] = len(vertices) + middle
                # The first triangles of all cubes of a case come before the second ones.
                face = first_face[case] + done[case]
                _write_faces(faces[face :: n_cubes[case]], corner, table, case)
                done[case] += 1
    return faces, middles


@inner()
def _cases(body: Mask) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """The case of each cube, one bit for each corner in the set; and the number of cubes of each case."""
    a, b, c = body.shape[0] - 1, body.shape[1] - 1, body.shape[2] - 1
    cases = np.zeros((a, b, c), dtype=np.uint8)
    n_cubes = np.zeros(256, dtype=np.int64)
    for x in range(a):
        for y in range(b):
            for z in range(c):
                case = 0
                for k in range(8):
                    case |= body[x + (k >> 2), y + (k >> 1 & 1), z + (k & 1)] << k
                cases[x, y, z] = case
                n_cubes[case] += 1
    return cases, n_cubes


@inner()
def _firsts(
    n_cubes: NDArray[np.int64], table: Table
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(257,) the number of faces, and of vertices in the middle, before those of each case and of all."""
    first_face, first_middle = (
        np.zeros(257, dtype=np.int64),
        np.zeros(257, dtype=np.int64),
    )
    for case in range(256):
        has_middle = table.loops[case, 0] >= 0
        first_face[case + 1] = first_face[case] + n_cubes[case] * table.n_triangles[case]
        first_middle[case + 1] = first_middle[case] + n_cubes[case] * has_middle
    return first_face, first_middle


@inner()
def _number_layer(
    number: IntArray,
    links: tuple[NDArray[np.intp], ...],
    begin: NDArray[np.int64],
    x: int,
) -> None:
    """Write the numbers of the vertices of layer x, which begin at `begin` of the links of each axis."""
    before = (0, len(links[0]), len(links[0]) + len(links[1]))
    for axis in range(3):
        at, i = links[axis], begin[axis]
        while i < len(at) and at[i, 0] == x:
            number[axis, x % 2, at[i, 1], at[i, 2]] = before[axis] + i
            i += 1
        begin[axis] = i


@inner()
def _set_corners(
    corner: IntArray, table: Table, case: int, number: IntArray, x: int, y: int, z: int
) -> None:
    """Write the vertices on those edges of a cube that its triangles use."""
    for t in range(table.n_triangles[case]):
        for side in range(3):
            edge = table.triangles[case, t, side]
            if edge < MIDDLE:
                low = LOWER[edge]
                corner[edge] = number[
                    AXIS[edge], (x + low[0]) % 2, y + low[1], z + low[2]
                ]


@inner()
def _set_middle(
    middle: FloatArray, vertices: FloatArray, corner: IntArray, loop: IntArray
) -> None:
    """Write the mean of the vertices of a loop."""
    length = 0
    while length < MOST and loop[length] >= 0:
        middle += vertices[corner[loop[length]]]
        length += 1
    middle /= length


@inner()
def _write_faces(faces: IntArray, corner: IntArray, table: Table, case: int) -> None:
    """Write the triangles of a cube into the first of the faces."""
    for t in range(table.n_triangles[case]):
        for side in range(3):
            faces[t, side] = corner[table.triangles[case, t, side]]


def crossed(body: Mask) -> list[NDArray[np.intp]]:
    """For each axis, the (k, 3) voxels of which the next is not in the set if they are, or the reverse."""
    pairs = (
        (body[1:], body[:-1]),
        (body[:, 1:], body[:, :-1]),
        (body[:, :, 1:], body[:, :, :-1]),
    )
    return [voxels_of(after != here) for after, here in pairs]


def voxels_of(mask: Mask) -> NDArray[np.intp]:
    """(k, 3) voxels of a set."""
    return np.stack(np.unravel_index(np.flatnonzero(mask), mask.shape), axis=1)


@cache
def _table() -> Table:
    triangles = np.full((256, MOST, 3), -1, dtype=np.int32)
    n_triangles = np.zeros(256, dtype=np.int32)
    loops = np.full((256, MOST), -1, dtype=np.int32)
    for case in range(1, 255):
        found = _tube(case) if case in TUBES else []
        for loop in [] if found else _loops(case):
            if len(loop) < LONG:
                found = found + [
                    [loop[0], loop[i], loop[i + 1]] for i in range(1, len(loop) - 1)
                ]
            else:
                loops[case, : len(loop)] = loop
                ends = zip(loop, loop[1:] + loop[:1], strict=True)
                found = found + [[first, last, MIDDLE] for first, last in ends]
        triangles[case, : len(found)] = found
        n_triangles[case] = len(found)
    return Table(triangles, n_triangles, loops)


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


def _tube(case: int) -> list[list[int]]:
    """Triangles, as edges of the cube, of the tube between the loops around two opposite outer corners."""
    ends = _loops(case)
    triangles = []
    for loop, other in (ends, ends[::-1]):
        for first, last in zip(loop, loop[1:] + loop[:1], strict=True):
            # The corner that both edges share is adjacent to the corner at the other end of the tube.
            corners = [*EDGES[first], *EDGES[last]]
            outer = max(corners, key=corners.count)
            across = (
                outer
                ^ (EDGES[first][0] ^ EDGES[first][1])
                ^ (EDGES[last][0] ^ EDGES[last][1])
            )
            triangles.append(
                [first, last, next(edge for edge in other if across in EDGES[edge])]
            )
    return triangles


@cache
def _cube_faces() -> list[list[int]]:
    """The corners of each face of a cube, counter-clockwise seen from outside the cube."""
    faces = []
    for axis in range(3):
        along, across, up = (4 >> (axis + k) % 3 for k in range(3))
        for side in (0, 1):
            ring = [
                side * along + u * across + v * up
                for u, v in ((0, 0), (1, 0), (1, 1), (0, 1))
            ]
            faces.append(ring if side else ring[::-1])
    return faces


# The factors λ > 0 and μ < −λ of Taubin's filter: a low-pass filter without shrinkage.
SHRINK = 0.5
SWELL = -0.53


def smoothed(
    vertices: FloatArray, faces: IntArray, moving: NDArray[np.intp], n_rounds: int
) -> FloatArray:
    """(n, 3) vertices of a closed manifold, of which those with the numbers `moving` are smoothed [1]_.

    References
    ----------
    .. [1] Taubin, "A signal processing approach to fair surface design", SIGGRAPH 1995.
    """
    from scipy.sparse import csr_array

    number = np.full(len(vertices), -1)
    number[moving] = np.arange(len(moving))
    tail, head = number[faces.ravel()], faces[:, [1, 2, 0]].ravel()  # half-edges
    leaving = np.flatnonzero(tail >= 0)
    leaving = leaving[np.argsort(tail[leaving], kind="stable")]
    counts = np.bincount(tail[leaving], minlength=len(moving))
    starts = np.concatenate([[0], np.cumsum(counts)])
    # (k, n) whether a vertex is a neighbour of each moving one.
    beside = csr_array(
        (np.ones(len(leaving)), head[leaving], starts), (len(moving), len(vertices))
    )
    result: FloatArray = vertices.copy()
    for factor in n_rounds * [SHRINK, SWELL]:
        here = result[moving]
        result[moving] = here + factor * (beside @ result / counts[:, None] - here)
    return result
