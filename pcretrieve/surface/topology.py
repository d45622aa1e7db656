"""Components, orientation and defects of a triangulation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pcretrieve.surface.edges import Index, edges_of, fans, is_connected, joined_by, twins
from pcretrieve.values import FloatArray, IntArray, TriangleMesh

__all__ = ["Defects", "compact", "components", "defects", "face_groups", "orient_faces"]


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
            found.append(f"{self.components} components" if self.components else "no faces")
        return ", ".join(found) or "none"


SOUND = Defects(0, 0, 0, 0, 0, 1)


def defects(mesh: TriangleMesh) -> Defects:
    """Count the defects of a mesh.

    Self-intersections are not counted: the Laplace–Beltrami operator does not depend on them, and their
    detection takes a hundred times longer than everything else (docs/decisions.md, defects).
    """
    if _is_sound(mesh):
        return SOUND
    edges = edges_of(mesh.faces)
    crowded = edges.use > 2
    _, first = np.unique(fans(edges, edges.pairs), return_index=True)  # one corner of each fan
    pinched = np.bincount(edges.tail[first], minlength=len(mesh.vertices)) > 1  # (n,)
    pinched[edges.ends[crowded]] = False
    sound = np.unique(face_groups(mesh.faces)[~mesh.flat_faces])  # groups
    return Defects(
        boundary_edges=int((edges.use == 1).sum()),
        non_manifold_edges=int(crowded.sum()),
        non_manifold_vertices=int(pinched.sum()),
        inconsistent_edges=int(((edges.use == 2) & (edges.balance != 0)).sum()),
        degenerate_faces=len(mesh.faces) - len(sound),
        components=int(components(mesh).max(initial=-1)) + 1,
    )


def _is_sound(mesh: TriangleMesh) -> bool:
    """Whether a mesh has no defects, which takes a quarter of the time that it takes to count them."""
    # Of two faces, which may have the same corners, the defects are counted.
    if len(mesh.faces) <= 2:
        return False
    twin, n_bad = twins(mesh.faces.flatten(), len(mesh.vertices))
    return n_bad == 0 and is_connected(twin) and not mesh.flat_faces.any()


def components(mesh: TriangleMesh) -> Index:
    """The connected components of a mesh.

    Returns (m,) int: number of the component of each face, in order of descending area.
    """
    a, b, c = mesh.faces.T
    of_vertex = joined_by(np.concatenate([a, b]), np.concatenate([b, c]), len(mesh.vertices))  # (n,)
    _, of_face = np.unique(of_vertex[a], return_inverse=True)  # (m,); unreferenced vertices are no components
    largest_first = np.argsort(-np.bincount(of_face, weights=mesh.face_areas), kind="stable")
    return np.asarray(np.argsort(largest_first)[of_face], dtype=np.intp)


def orient_faces(mesh: TriangleMesh) -> tuple[TriangleMesh, int] | None:
    """Reverse faces until the orientation is consistent at every edge with two faces.

    Returns (TriangleMesh, int) or None: the consistently oriented mesh, and the number of reversed faces. In
        each patch of faces that are connected at edges with two faces, the orientation of the majority is
        kept; if both are equally frequent, that of the first face. None if the surface is not orientable (a
        Möbius strip).
    """
    edges, m = edges_of(mesh.faces), len(mesh.faces)
    a, b = edges.pairs.T  # half-edges
    disagree = (edges.tail[a] < edges.head[a]) == (edges.tail[b] < edges.head[b])
    # The orientation double cover: two copies of each face, one of them reversed. At
    # each edge, copies of consistent orientation are connected. A surface is not
    # orientable if a face is connected to its own reversed copy.
    patch = joined_by(
        np.concatenate([a // 3, a // 3 + m]),
        np.concatenate([b // 3 + m * disagree, b // 3 + m * ~disagree]),
        2 * m,
    )
    as_given, turned = patch[:m], patch[m:]  # (m,)
    if (as_given == turned).any():
        return None
    votes = np.bincount(as_given, minlength=2 * m)  # number of unreversed faces in each sheet of the cover
    # Classes are numbered by their first elements: of two sheets the one with the
    # unreversed first face is lower.
    turn = (votes[as_given] < votes[turned]) | ((votes[as_given] == votes[turned]) & (as_given > turned))
    faces = np.where(turn[:, None], mesh.faces[:, ::-1], mesh.faces)
    return TriangleMesh(mesh.vertices, faces, mesh.provenance), int(turn.sum())


def compact(vertices: FloatArray, faces: IntArray) -> TriangleMesh:
    """A mesh of the vertices that are referenced by faces.

    vertices: (n, 3) float64, coordinates.
    faces: (m, 3) int32, vertex numbers of each face.
    """
    used = np.zeros(len(vertices), dtype=bool)
    used[faces] = True
    number = np.cumsum(used) - 1
    return TriangleMesh(vertices[used], number[faces])


def face_groups(faces: NDArray[np.integer]) -> Index:
    """Group faces that have the same three corners, in any order.

    faces: (m, 3) int, vertex numbers of each face.
    Returns (m,) int: number of the group of each face.
    """
    corners = np.sort(faces, axis=1)  # (m, 3)
    order = np.lexsort(corners.T)
    new = np.diff(corners[order], axis=0, prepend=-1).any(axis=1)  # (m,)
    group = np.empty(len(faces), dtype=np.intp)
    group[order] = np.cumsum(new) - 1
    return group
