"""The edges of a triangulation, the fans of faces around its vertices, its defects and components."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pcretrieve.arrays import FloatArray, IntArray, joined_by
from pcretrieve.values.compiled import compiled
from pcretrieve.values.geometry import TriangleMesh

Index = NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """The edges of m faces, as groups of half-edges.

    Half-edge 3 f + k is side k of face f, from corner k to corner k + 1 (modulo 3).

    tail, head: (3m,) int, vertex at the start and at the end of each half-edge.
    order: (3m,) int, the half-edges, grouped by edge.
    starts: (e,) int, position in `order` of the first half-edge of each edge.
    use: (e,) int, number of faces at each edge: 1 on the boundary, 2 in the interior of a manifold.
    balance: (e,) int, number of half-edges from the lower to the higher vertex number, minus the number in
        the opposite direction: 0 in the interior of an oriented manifold.
    """

    tail: NDArray[np.integer]
    head: NDArray[np.integer]
    order: Index
    starts: Index
    use: Index
    balance: Index

    @property
    def ends(self) -> NDArray[np.integer]:
        """(e, 2) vertices of each edge."""
        first = self.order[self.starts]
        return np.column_stack([self.tail[first], self.head[first]])

    @property
    def crowd(self) -> Index:
        """(3m,) number of faces at the edge of each half-edge."""
        crowd = np.empty_like(self.order)
        crowd[self.order] = np.repeat(self.use, self.use)
        return crowd

    @property
    def pairs(self) -> Index:
        """(p, 2) half-edges of each edge with exactly two faces."""
        return np.asarray(self.order[np.repeat(self.use == 2, self.use)].reshape(-1, 2))


def edges_of(faces: NDArray[np.integer]) -> Edges:
    """The edges of a triangulation, in ascending order of the lower and then of the higher vertex number."""
    tail, head = faces.ravel(), faces[:, [1, 2, 0]].ravel()  # (3m,)
    low, high = np.minimum(tail, head).astype(np.int64), np.maximum(tail, head)
    key = low * (int(high.max(initial=0)) + 1) + high
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    direction = np.where(tail < head, 1, -1)
    return Edges(
        tail=tail,
        head=head,
        order=order,
        starts=starts,
        use=np.diff(starts, append=len(order)),
        balance=np.add.reduceat(direction[order], starts),
    )


def fans(edges: Edges, pairs: Index) -> Index:
    """(3m,) number of the fan of faces around its vertex of each corner, that of face f at 3 f + k.

    Two corners at one vertex are in one fan if their faces are connected by paired half-edges. A vertex of a
    manifold has one fan.

    pairs: (p, 2) int, pairs of half-edges at which two faces are connected.
    """
    # Half-edge c goes from corner c to corner after[c].
    corner = np.arange(len(edges.tail))
    after = np.where(corner % 3 == 2, corner - 2, corner + 1)
    a, b = pairs.T
    parallel = edges.tail[a] == edges.tail[b]  # faces of inconsistent orientation
    return joined_by(
        np.concatenate([a, after[a]]),
        np.concatenate(
            [np.where(parallel, b, after[b]), np.where(parallel, after[b], b)]
        ),
        len(corner),
    )


@dataclass(frozen=True, slots=True)
class Defects:
    """The number of each kind of defect of a triangulation."""

    boundary_edges: int
    non_manifold_edges: int
    non_manifold_vertices: int
    inconsistent_edges: int
    degenerate_faces: int
    components: int

    def __bool__(self) -> bool:
        return self != SOUND

    def __str__(self) -> str:
        names = (
            (self.boundary_edges, "boundary edges"),
            (self.non_manifold_edges, "non-manifold edges"),
            (self.non_manifold_vertices, "non-manifold vertices"),
            (self.inconsistent_edges, "edges between faces of opposite orientation"),
            (self.degenerate_faces, "degenerate or duplicate faces"),
        )
        found = [f"{count} {name}" for count, name in names if count]
        if self.components != 1:
            found.append(
                f"{self.components} components" if self.components else "no faces"
            )
        return ", ".join(found) or "none"


SOUND = Defects(0, 0, 0, 0, 0, 1)


def defects(mesh: TriangleMesh) -> Defects:
    """Count the defects of a mesh.

    Self-intersections are not counted: the Laplace–Beltrami operator does not depend on them, and their
    detection takes a hundred times longer than everything else.
    """
    _, n_bad = twins(mesh.faces.flatten(), len(mesh.vertices))
    n_components = int(components(mesh).max(initial=-1)) + 1
    # Two faces with the same corners would be a component of their own.
    if (
        not n_bad
        and n_components == 1
        and len(mesh.faces) > 2
        and not mesh.flat_faces.any()
    ):
        return SOUND  # as most meshes are, which takes half the time
    edges = edges_of(mesh.faces)
    crowded = edges.use > 2
    # One corner of each fan, since fans are numbered in the order of their first corners.
    first = np.flatnonzero(
        np.diff(np.maximum.accumulate(fans(edges, edges.pairs)), prepend=-1)
    )
    pinched = np.bincount(edges.tail[first], minlength=len(mesh.vertices)) > 1  # (n,)
    pinched[edges.ends[crowded]] = False
    sound = np.unique(face_groups(mesh.faces)[~mesh.flat_faces])  # groups
    return Defects(
        boundary_edges=int((edges.use == 1).sum()),
        non_manifold_edges=int(crowded.sum()),
        non_manifold_vertices=int(pinched.sum()),
        inconsistent_edges=int(((edges.use == 2) & (edges.balance != 0)).sum()),
        degenerate_faces=len(mesh.faces) - len(sound),
        components=n_components,
    )


@compiled()
def twins(corners: IntArray, n_vertices: int) -> tuple[IntArray, int]:
    """The twins of half-edges, those in the opposite direction; and in how many places there is no manifold.

    Half-edge 3 f + k is side k of face f, from corner k to corner k + 1 (modulo 3).
    """
    starts = np.cumsum(np.bincount(corners + 1, minlength=n_vertices + 1))
    fill = starts[:-1].copy()
    # Half-edges, grouped by their first vertex, each with its other vertex, which is thus read in order.
    leaving = np.empty((len(corners), 2), dtype=np.int32)
    for f in range(0, len(corners), 3):
        for k in range(3):
            i = fill[corners[f + k]]
            leaving[i, 0], leaving[i, 1] = f + k, corners[f + (k + 1) % 3]
            fill[corners[f + k]] += 1
    twin = np.full(len(corners), -1, dtype=np.int32)
    n_bad = 0
    for f in range(0, len(corners), 3):
        for k in range(3):
            tail, head = corners[f + k], corners[f + (k + 1) % 3]
            n_back = 0
            for i in range(starts[head], starts[head + 1]):
                if leaving[i, 1] == tail:
                    twin[f + k] = leaving[i, 0]
                    n_back += 1
            # Of two half-edges with the same ends, each opposite half-edge has two twins.
            n_bad += tail == head or n_back != 1
    if n_bad:
        return twin, n_bad
    for v in range(n_vertices):
        n_around = starts[v + 1] - starts[v]
        if n_around:
            first = leaving[starts[v], 0]
            h = twin[first + 2 if first % 3 == 0 else first - 1]
            n_fan = 1
            while h != first:
                h = twin[h + 2 if h % 3 == 0 else h - 1]
                n_fan += 1
            n_bad += n_fan != n_around
    return twin, n_bad


def components(mesh: TriangleMesh) -> Index:
    """(m,) number of the connected component of each face, in order of descending area."""
    a, b, c = mesh.faces.T
    of_vertex = joined_by(
        np.concatenate([a, b]), np.concatenate([b, c]), len(mesh.vertices)
    )  # (n,)
    of_face = of_vertex[a]
    areas = np.bincount(of_face, weights=mesh.face_areas)
    # Unreferenced vertices are no components.
    areas[np.bincount(of_face) == 0] = -1
    largest_first = np.argsort(-areas, kind="stable")
    return np.asarray(np.argsort(largest_first)[of_face], dtype=np.intp)


def orient_faces(mesh: TriangleMesh) -> tuple[TriangleMesh, int] | None:
    """The mesh with a consistent orientation at every edge with two faces, and the number of reversed faces.

    In each patch of faces that are connected at edges with two faces, the orientation of the majority is
    kept; if both are equally frequent, that of the first face. None if the surface is not orientable (a
    Möbius strip).
    """
    edges, m = edges_of(mesh.faces), len(mesh.faces)
    a, b = edges.pairs.T  # half-edges
    disagree = (edges.tail[a] < edges.head[a]) == (edges.tail[b] < edges.head[b])
    # The orientation double cover: two copies of each face, one of them reversed. At each edge, copies of
    # consistent orientation are connected. A surface is not orientable if a face is connected to its own
    # reversed copy.
    patch = joined_by(
        np.concatenate([a // 3, a // 3 + m]),
        np.concatenate([b // 3 + m * disagree, b // 3 + m * ~disagree]),
        2 * m,
    )
    as_given, turned = patch[:m], patch[m:]  # (m,)
    if (as_given == turned).any():
        return None
    # Number of unreversed faces in each sheet of the cover.
    votes = np.bincount(as_given, minlength=2 * m)
    # Classes are numbered by their first elements: of two sheets the one with the unreversed first face is
    # lower.
    turn = (votes[as_given] < votes[turned]) | (
        (votes[as_given] == votes[turned]) & (as_given > turned)
    )
    faces = np.where(turn[:, None], mesh.faces[:, ::-1], mesh.faces)
    return TriangleMesh(mesh.vertices, faces, mesh.provenance), int(turn.sum())


def compact(vertices: FloatArray, faces: IntArray) -> TriangleMesh:
    """A mesh of the vertices that are referenced by faces."""
    used = np.zeros(len(vertices), dtype=bool)
    used[faces] = True
    number = np.cumsum(used) - 1
    return TriangleMesh(vertices[used], number[faces])


def face_groups(faces: NDArray[np.integer]) -> Index:
    """(m,) number of the group of each face, of faces with the same three corners in any order."""
    corners = np.sort(faces, axis=1)  # (m, 3)
    order = np.lexsort(corners.T)
    new = np.diff(corners[order], axis=0, prepend=-1).any(axis=1)  # (m,)
    group = np.empty(len(faces), dtype=np.intp)
    group[order] = np.cumsum(new) - 1
    return group


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceMarks:
    """Where the topology of a surface was changed.

    cuts: (k, 3) float64, centres of the voxels that were removed to obtain the requested genus.
    bridges: (j, 3) float64, centres of the voxels that were added to connect a component to the body.
    base: (p, 3) float64, points of the caps of the base on which the body stands, where no points were
        measured.
    """

    cuts: FloatArray
    bridges: FloatArray
    base: FloatArray

    def moved(self, by: FloatArray) -> SurfaceMarks:
        """All places, translated."""
        return SurfaceMarks(self.cuts + by, self.bridges + by, self.base + by)
