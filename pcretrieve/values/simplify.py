"""Surface → the same surface with fewer faces: edge collapse by quadric errors, compiled by numba."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.arrays import DOUBLE_OFFSET, FloatArray, Frame, IntArray, Mask
from pcretrieve.arrays.open3d import open3d_mesh
from pcretrieve.errors import DegenerateMeshError
from pcretrieve.values.compiled import compiled, inlined, inner
from pcretrieve.values.geometry import TriangleMesh
from pcretrieve.values.topology import compact, twins

# Weight of the squared distance along the surface, relative to the squared distance from it. A smaller weight
# preserves creases better, a larger one gives faces of more even shape.
EVENNESS = 0.02

# Smallest weight of a vertex, relative to the mean weight, so that the quadric of every edge has a unique
# minimum even if all faces at its vertices are degenerate.
LEAST_WEIGHT = 1e-6

# Cosine of the largest angle by which the normal of a face may turn in one collapse.
LEAST_COSINE = 0.8

# Smallest quality of a face (1 is equilateral, 0 is degenerate) after a collapse, unless it was less before.
LEAST_QUALITY = 0.5

# Sorts after all keys.
LAST_KEY = np.iinfo(np.int64).max

Keys = NDArray[np.int64]
Point = tuple[float, float, float]


def simplified(mesh: TriangleMesh, n_faces: int) -> TriangleMesh:
    """A surface with at most `n_faces` faces and the same topology, by edge collapse [1]_.

    An edge is collapsed only if it satisfies the link condition [2]_, so that the Euler characteristic, the
    manifoldness and the orientation of every component are preserved, and if no face turns over or becomes a
    sliver. If no such edge is left, the result has more than `n_faces` faces. The edge of least cost is
    collapsed first. Its vertex moves to the minimum x, and its cost is the minimum value, of

        Σ A_f/3 ((n_f · (x − p_f))² + EVENNESS |x − p_f|²)

    over the original corners p_f, in faces f of normal n_f and area A_f, that have been collapsed into the
    vertex. The second term gives faces of even shape. The result does not depend on the unit of length.

    References
    ----------
    .. [1] Garland and Heckbert, "Surface simplification using quadric error metrics", SIGGRAPH 1997.
    .. [2] Dey, Edelsbrunner, Guha and Nekhayev, "Topology preserving edge contraction", Publications de
       l'Institut Mathématique 66, 1999.
    """
    # (n, 3), (3m,): modified below.
    vertices, corners = (mesh.vertices.copy(), mesh.faces.flatten())
    twin, n_bad = twins(corners, len(vertices))
    if n_bad:
        raise DegenerateMeshError(
            "a surface must be closed, manifold and oriented to be simplified, this one is not at "
            f"{n_bad} half-edges or vertices; repair it first"
        )
    quadrics, area = _quadrics(vertices, corners)
    if not area > 0:
        raise DegenerateMeshError(f"no face of {len(mesh.faces)} has an area")
    quadrics[:, :3] += LEAST_WEIGHT * EVENNESS * area / len(vertices)
    _collapsed(vertices, corners, twin, quadrics / area, area, n_faces)
    return compact(vertices, corners.reshape(-1, 3)[corners[::3] >= 0])


@inner()
def _next(h: int) -> int:
    return h - 2 if h % 3 == 2 else h + 1


@inner()
def _previous(h: int) -> int:
    return h + 2 if h % 3 == 0 else h - 1


@compiled()
def _quadrics(vertices: FloatArray, corners: IntArray) -> tuple[FloatArray, float]:
    """The (n, 6) quadrics Σ A_f/3 (n_f n_fᵀ + EVENNESS I) as xx, yy, zz, xy, xz, yz; and the area."""
    quadrics = np.zeros((len(vertices), 6))
    area = 0.0
    for f in range(0, len(corners), 3):
        a, b, c = (
            _at(vertices, corners[f]),
            _at(vertices, corners[f + 1]),
            _at(vertices, corners[f + 2]),
        )
        x, y, z, double = _normal(a, b, c)
        area += double / 2
        even = EVENNESS * double / 6
        # (x, y, z) has the length `double`.
        steep = 1 / (6 * double) if double > 0 else 0.0
        for v in corners[f : f + 3]:
            quadrics[v, 0] += steep * x * x + even
            quadrics[v, 1] += steep * y * y + even
            quadrics[v, 2] += steep * z * z + even
            quadrics[v, 3] += steep * x * y
            quadrics[v, 4] += steep * x * z
            quadrics[v, 5] += steep * y * z
    return quadrics, area


@inner()
def _at(vertices: FloatArray, v: int) -> Point:
    # Numbers, because counting the references to a row of an array takes longer than the arithmetic.
    return vertices[v, 0], vertices[v, 1], vertices[v, 2]


@inner()
def _normal(a: Point, b: Point, c: Point) -> tuple[float, float, float, float]:
    """The normal of a triangle with twice its area as the length, and this length."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return x, y, z, np.sqrt(x * x + y * y + z * z)


@inlined()
def _times(q: FloatArray, u: int, x: float, y: float, z: float) -> Point:
    return (
        q[u, 0] * x + q[u, 3] * y + q[u, 4] * z,
        q[u, 3] * x + q[u, 1] * y + q[u, 5] * z,
        q[u, 4] * x + q[u, 5] * y + q[u, 2] * z,
    )


@inlined()
def _meeting(vertices: FloatArray, q: FloatArray, u: int, v: int) -> tuple[float, Point]:
    """The additional cost of the minimum of the quadrics of two vertices, and its place."""
    # Each vertex is at the minimum of its own quadric, so that a displacement y costs yᵀ Q y more. The
    # minimum x of the sum solves Q_u (x − u) + Q_v (x − v) = 0.
    dx = vertices[v, 0] - vertices[u, 0]
    dy = vertices[v, 1] - vertices[u, 1]
    dz = vertices[v, 2] - vertices[u, 2]
    matrix = (
        q[u, 0] + q[v, 0],
        q[u, 1] + q[v, 1],
        q[u, 2] + q[v, 2],
        q[u, 3] + q[v, 3],
        q[u, 4] + q[v, 4],
        q[u, 5] + q[v, 5],
    )
    x, y, z = _solved(matrix, _times(q, v, dx, dy, dz))
    one, two = _times(q, u, x, y, z), _times(q, v, dx - x, dy - y, dz - z)
    cost = x * one[0] + y * one[1] + z * one[2]
    cost = cost + (dx - x) * two[0] + (dy - y) * two[1] + (dz - z) * two[2]
    return float(cost), (vertices[u, 0] + x, vertices[u, 1] + y, vertices[u, 2] + z)


@inlined()
def _solved(
    matrix: tuple[float, float, float, float, float, float], right: Point
) -> Point:
    """The solution of a symmetric system xx, yy, zz, xy, xz, yz, by the cofactors of the matrix."""
    xx, yy, zz, xy, xz, yz = matrix
    cxx, cxy, cxz = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    cyy, cyz, czz = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    determinant = xx * cxx + xy * cxy + xz * cxz
    return (
        (cxx * right[0] + cxy * right[1] + cxz * right[2]) / determinant,
        (cxy * right[0] + cyy * right[1] + cyz * right[2]) / determinant,
        (cxz * right[0] + cyz * right[1] + czz * right[2]) / determinant,
    )


@inner()
def _key(cost: float, edge: int) -> int:
    """An integer that sorts by cost, then by edge number."""
    # The cost is rounded to single precision, so that rounding errors of double precision do not affect the
    # order.
    return int(np.int64(np.float32(cost).view(np.int32)) << 32 | edge)


@inlined()
def _sink(heap: Keys, size: int, at: int) -> None:
    """Move a key down a heap of some size, in which each key has four keys below it."""
    key = heap[at]
    while True:
        child = 4 * at + 1
        if child >= size:
            break
        # Without branches, which would be mispredicted.
        a = child + (heap[child + 1] < heap[child])
        b = child + 2 + (heap[child + 3] < heap[child + 2])
        least = b if heap[b] < heap[a] else a
        if heap[least] >= key:
            break
        heap[at] = heap[least]
        at = least
    heap[at] = key


@inlined()
def _rise(heap: Keys, at: int) -> None:
    key = heap[at]
    while at > 0 and heap[(at - 1) // 4] > key:
        heap[at] = heap[(at - 1) // 4]
        at = (at - 1) // 4
    heap[at] = key


@inlined()
def _keeps_shape(
    vertices: FloatArray, corners: IntArray, twin: IntArray, h: int, place: Point
) -> bool:
    """Whether no face turns over, or becomes a sliver, if both ends of a half-edge move to `place`."""
    poorest_before, poorest = np.inf, np.inf
    for start in (h, twin[h]):
        old = _at(vertices, corners[start])
        g = start
        while True:
            b, c = _at(vertices, corners[_next(g)]), _at(vertices, corners[_previous(g)])
            before = _normal(old, b, c)
            poorest_before = min(poorest_before, _quality(old, b, c, before[3]))
            following = twin[_previous(g)]
            if following == start:
                break
            # The first and the last face around each end are removed by the collapse.
            if g != start:
                after = _normal(place, b, c)
                cosine = (
                    before[0] * after[0] + before[1] * after[1] + before[2] * after[2]
                )
                if cosine < LEAST_COSINE * before[3] * after[3]:
                    return False
                poorest = min(poorest, _quality(place, b, c, after[3]))
            g = following
    return poorest >= min(poorest_before, LEAST_QUALITY)


@inner()
def _quality(a: Point, b: Point, c: Point, double: float) -> float:
    """4√3 area / Σ sides² of a triangle, where `double` is twice its area."""
    squares = 0.0
    for k in range(3):
        squares += (a[k] - b[k]) ** 2 + (b[k] - c[k]) ** 2 + (c[k] - a[k]) ** 2
    return 2 * np.sqrt(3) * double / squares if squares > 0 else 0.0


@inlined()
def _keeps_topology(
    corners: IntArray, twin: IntArray, h: int, mark: IntArray, label: int
) -> bool:
    """The link condition: the ends have exactly two common neighbours, and are not in a tetrahedron."""
    n_u, g = 0, h
    while n_u == 0 or g != h:
        mark[corners[_next(g)]] = label
        n_u += 1
        g = twin[_previous(g)]
    n_v, n_shared, g = 0, 0, twin[h]
    while n_v == 0 or g != twin[h]:
        n_shared += mark[corners[_next(g)]] == label
        n_v += 1
        g = twin[_previous(g)]
    return n_shared == 2 and n_u + n_v > 6


@inlined()
def _merge(
    corners: IntArray, twin: IntArray, edge: IntArray, half: IntArray, h: int
) -> int:
    """Collapse the head of a half-edge into its tail, and return a remaining half-edge from the tail."""
    g, tail = twin[h], corners[h]
    while corners[g] != tail:
        corners[g] = tail
        g = twin[_previous(g)]
    half[edge[h]] = -1
    stays = h
    for gone in (h, twin[h]):
        a, b = twin[_next(gone)], twin[_previous(gone)]
        half[edge[a]] = -1
        twin[a], twin[b] = b, a
        edge[a] = edge[b]
        half[edge[b]] = b
        corners[gone - gone % 3] = -1
        stays = b
    return stays


class Edges(NamedTuple):
    """The edges of a mesh, and the heap of the costs of their collapse.

    of: (3m,) the edge of each half-edge.
    half: (e,) a half-edge of each edge, −1 once it is removed.
    heap: (e + 3,) keys of the queued edges, the least first; then `LAST_KEY`.
    known: (e,) the step in which the cost of the edge was computed.
    queued: (e,) whether the edge is in the heap.
    """

    of: IntArray
    half: IntArray
    heap: Keys
    known: IntArray
    queued: Mask


@inner()
def _edges(
    vertices: FloatArray,
    corners: IntArray,
    twin: IntArray,
    quadrics: FloatArray,
    area: float,
) -> Edges:
    """All edges, queued by cost."""
    edge = np.empty(len(corners), dtype=np.int32)
    half = np.empty(len(corners) // 2, dtype=np.int32)
    heap = np.full(len(half) + 3, LAST_KEY)
    size = 0
    for h in range(len(corners)):
        if h < twin[h]:
            edge[h] = edge[twin[h]] = size
            half[size] = h
            cost, _ = _meeting(vertices, quadrics, corners[h], corners[twin[h]])
            heap[size] = _key(cost / area, size)
            size += 1
    for at in range(size // 4, -1, -1):
        _sink(heap, size, at)
    known = np.zeros(len(half), dtype=np.int32)
    return Edges(edge, half, heap, known, np.ones(len(half), dtype=np.bool_))


@inlined()
def _requeue(
    corners: IntArray,
    twin: IntArray,
    edges: Edges,
    start: int,
    is_rejected: Mask,
    size: int,
) -> int:
    """Queue the rejected edges around a vertex, which may be possible now; return the size of the heap."""
    # They are queued first: their costs were below those of all queued edges, unless an end was moved, and
    # then the cost is computed again.
    g = start
    while True:
        k = twin[g]
        w = corners[k]
        while is_rejected[w]:
            edge = edges.of[k]
            if not edges.queued[edge]:
                edges.queued[edge] = True
                edges.heap[size] = _key(0.0, edge)
                _rise(edges.heap, size)
                size += 1
            k = twin[_previous(k)]
            if k == twin[g]:
                is_rejected[w] = False
        g = twin[_previous(g)]
        if g == start:
            return size


@compiled()
def _collapsed(
    vertices: FloatArray,
    corners: IntArray,
    twin: IntArray,
    quadrics: FloatArray,
    area: float,
    n_faces: int,
) -> None:
    """Collapse edges in place; the corners of faces that do not remain become negative."""
    # The value of the quadric of each vertex at its position, and the step in which it was moved there.
    spent, moved = np.zeros(len(vertices)), np.zeros(len(vertices), dtype=np.int32)
    mark = np.zeros(len(vertices), dtype=np.int32)
    # Whether an edge of the vertex may not be queued.
    is_rejected = np.zeros(len(vertices), dtype=np.bool_)
    edges = _edges(vertices, corners, twin, quadrics, area)
    size, step, label = len(edges.half), 0, 0
    while len(corners) // 3 - 2 * step > n_faces and size > 0:
        edge = edges.heap[0] & 0x7FFFFFFF
        h = edges.half[edge]
        if h < 0:
            size = _popped(edges, size)
            continue
        u, v = corners[h], corners[twin[h]]
        cost, place = _meeting(vertices, quadrics, u, v)
        cost = cost + spent[u] + spent[v]
        if max(moved[u], moved[v]) > edges.known[edge]:
            # Lazy update: costs never decrease, so that the first edge whose cost is up to date is the
            # minimum.
            edges.known[edge] = step
            edges.heap[0] = _key(cost / area, edge)
            _sink(edges.heap, size, 0)
            continue
        size = _popped(edges, size)
        label += 1
        if not _keeps_topology(corners, twin, h, mark, label) or not _keeps_shape(
            vertices, corners, twin, h, place
        ):
            is_rejected[u] = is_rejected[v] = True
            continue
        step += 1
        _join(vertices, quadrics, u, v, place)
        spent[u] = cost
        moved[u] = step
        h = _merge(corners, twin, edges.of, edges.half, h)
        is_rejected[u] |= is_rejected[v]
        size = _requeue(corners, twin, edges, h, is_rejected, size)


@inlined()
def _join(
    vertices: FloatArray, quadrics: FloatArray, u: int, v: int, place: Point
) -> None:
    """Move a vertex to a place, and add the quadric of another to its own."""
    # Numba takes a second to compile the message of an assignment of a row to a row of another length.
    vertices[u, 0], vertices[u, 1], vertices[u, 2] = place[0], place[1], place[2]
    for k in range(quadrics.shape[1]):
        quadrics[u, k] += quadrics[v, k]


@inlined()
def _popped(edges: Edges, size: int) -> int:
    """Remove the first edge from a heap of some size; returns the new size."""
    edges.queued[edges.heap[0] & 0x7FFFFFFF] = False
    size -= 1
    edges.heap[0], edges.heap[size] = edges.heap[size], LAST_KEY
    _sink(edges.heap, size, 0)
    return size


# Surfaces with diagonals in this range are decimated in the caller's unit of length.
ORDINARY = 1e-6, 1e6


def decimated(mesh: TriangleMesh, n_faces: int) -> TriangleMesh:
    """A surface with about `n_faces` faces, by Open3D, which keeps neither topology nor manifoldness."""
    frame = Frame.around(mesh.vertices, offset=DOUBLE_OFFSET)
    # Open3D compares determinants of quadrics with 1e-4 in any unit of length, so another unit gives other
    # vertices. It computes in double precision here: ordinary lengths need no frame.
    if ORDINARY[0] <= mesh.diagonal <= ORDINARY[1]:
        frame = Frame(np.zeros(3), 1.0)
    found = open3d_mesh(
        frame.inward(mesh.vertices), mesh.faces
    ).simplify_quadric_decimation(n_faces)
    return TriangleMesh(
        frame.outward(np.array(found.vertices)), np.array(found.triangles, dtype=np.int32)
    )
