"""What a triangulation is made of, and what is wrong with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pcretrieve.surface.edges import Index, edges_of, fans, joined_by
from pcretrieve.types import FloatArray, IntArray, TriangleMesh

__all__ = ["Defects", "compact", "components", "defects", "orient_faces", "twins"]


@dataclass(frozen=True, slots=True)
class Defects:
    """Counts of what keeps a triangulation from being a closed, oriented, connected manifold.

    Attributes
    ----------
    boundary_edges : int
        Edges of one face.
    non_manifold_edges : int
        Edges of three faces or more.
    non_manifold_vertices : int
        Vertices where more than one fan of faces meets, apart from the ends of non-manifold edges.
    inconsistent_edges : int
        Edges of two faces that disagree on which side is outside.
    degenerate_faces : int
        Faces without an area, or with the corners of an earlier face.
    components : int
        Pieces that share no vertex; 1 in a connected surface.
    """

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
    """Count the defects of a mesh; falsy where it is a closed, oriented, connected manifold.

    Self-intersection is not a defect here: the Laplace–Beltrami operator does not see it, and testing for
    it takes a hundred times longer than all the rest.
    """
    edges = edges_of(mesh.faces)
    crowded = edges.use > 2
    _, first = np.unique(fans(edges, edges.pairs), return_index=True)  # a corner of each fan
    pinched = np.bincount(edges.tail[first], minlength=len(mesh.vertices)) > 1  # (n,)
    pinched[edges.ends[crowded]] = False
    sound = np.unique(twins(mesh.faces)[~mesh.flat_faces])  # groups
    return Defects(
        boundary_edges=int((edges.use == 1).sum()),
        non_manifold_edges=int(crowded.sum()),
        non_manifold_vertices=int(pinched.sum()),
        inconsistent_edges=int(((edges.use == 2) & (edges.balance != 0)).sum()),
        degenerate_faces=len(mesh.faces) - len(sound),
        components=int(components(mesh).max(initial=-1)) + 1,
    )


def components(mesh: TriangleMesh) -> Index:
    """(m,) number of the connected piece that each face belongs to, 0 for the piece of largest area."""
    a, b, c = mesh.faces.T
    of_vertex = joined_by(np.concatenate([a, b]), np.concatenate([b, c]), len(mesh.vertices))  # (n,)
    _, of_face = np.unique(of_vertex[a], return_inverse=True)  # (m,); loose vertices are no pieces
    largest_first = np.argsort(-np.bincount(of_face, weights=mesh.face_areas), kind="stable")
    return np.asarray(np.argsort(largest_first)[of_face], dtype=np.intp)


def orient_faces(mesh: TriangleMesh) -> tuple[TriangleMesh, int] | None:
    """Turn faces until neighbours agree; None where that cannot be (a Möbius strip).

    Faces are neighbours across edges that no third face shares.

    Returns
    -------
    mesh : TriangleMesh
        Each patch of neighbours keeps the side of most of its faces; where as many want one side as the
        other, that of its first face.
    n_turned : int
    """
    edges, m = edges_of(mesh.faces), len(mesh.faces)
    a, b = edges.pairs.T  # half-edges
    disagree = (edges.tail[a] < edges.head[a]) == (edges.tail[b] < edges.head[b])
    # Two copies of each face, one turned: neighbours that agree join like copies, others join unlike ones.
    # A face joined to its own turned copy lies on a one-sided surface.
    patch = joined_by(
        np.concatenate([a // 3, a // 3 + m]),
        np.concatenate([b // 3 + m * disagree, b // 3 + m * ~disagree]),
        2 * m,
    )
    as_given, turned = patch[:m], patch[m:]  # (m,)
    if (as_given == turned).any():
        return None
    votes = np.bincount(as_given, minlength=2 * m)  # faces that each choice of copies leaves as they are
    # Patches are numbered by their first members: among rivals, the first face's own copy comes first.
    turn = (votes[as_given] < votes[turned]) | ((votes[as_given] == votes[turned]) & (as_given > turned))
    faces = np.where(turn[:, None], mesh.faces[:, ::-1], mesh.faces)
    return TriangleMesh(mesh.vertices, faces, mesh.provenance), int(turn.sum())


def compact(vertices: FloatArray, faces: IntArray) -> TriangleMesh:
    """The mesh of these faces, without the vertices that none of them uses."""
    used = np.zeros(len(vertices), dtype=bool)
    used[faces] = True
    number = np.cumsum(used) - 1
    return TriangleMesh(vertices[used], number[faces])


def twins(faces: NDArray[np.integer]) -> Index:
    """(m,) group of each face: faces with the same corners, in whatever order, are in one group."""
    corners = np.sort(faces, axis=1)  # (m, 3)
    order = np.lexsort(corners.T)
    new = np.diff(corners[order], axis=0, prepend=-1).any(axis=1)  # (m,)
    group = np.empty(len(faces), dtype=np.intp)
    group[order] = np.cumsum(new) - 1
    return group
