"""Splitting of non-manifold edges and vertices."""

from __future__ import annotations

import numpy as np

from pcretrieve.surface.edges import Edges, Index, edges_of, fans
from pcretrieve.values import TriangleMesh

__all__ = ["split_non_manifold"]


def split_non_manifold(mesh: TriangleMesh) -> TriangleMesh:
    """Split edges with more than two faces, and vertices with more than one fan of faces [1]_.

    The faces around a non-manifold edge are sorted by angle and paired, such that each pair bounds one wedge
    of the interior. Each vertex is then copied once for each fan of paired faces. The shape does not change.
    If the faces around an edge do not bound an interior, as where three sheets meet, they are separated and
    leave a boundary.

    References
    ----------
    .. [1] A. Guéziec, G. Taubin, F. Lazarus and B. Horn, "Cutting and stitching: converting sets of polygons
       to manifold surfaces", IEEE Transactions on Visualization and Computer Graphics 7 (2001); without the
       pairing by the interior.
    """
    edges = edges_of(mesh.faces)
    crowded = edges.use > 2
    agreed = np.flatnonzero(crowded & (edges.balance == 0))
    pairs = np.concatenate([edges.pairs, *(_pairs_around(mesh, edges, edge) for edge in agreed.tolist())])
    fan = fans(edges, pairs)
    _, first = np.unique(fan, return_index=True)  # one corner of each fan
    vertices, faces = mesh.vertices[edges.tail[first]], fan.reshape(-1, 3)
    if crowded.any():
        # If both ends of an edge have one fan only, its pairs of faces still share the edge. Each pair then
        # gets a vertex of its own in the middle of the edge.
        still = edges_of(faces)
        sides = np.flatnonzero(still.crowd > 2)  # half-edges
        pair = np.arange(len(fan))
        pair[pairs[:, 1]] = pairs[:, 0]
        _, first, number = np.unique(pair[sides], return_index=True, return_inverse=True)
        middle = np.full(len(fan), -1)
        middle[sides] = len(vertices) + number
        ends = np.stack([still.tail, still.head])[:, sides[first]]  # (2, p)
        vertices = np.concatenate([vertices, vertices[ends].mean(axis=0)])
        faces = _cut_in_the_middle(faces, middle.reshape(-1, 3))
    return TriangleMesh(vertices, faces.astype(np.int32), mesh.provenance)


def _pairs_around(mesh: TriangleMesh, edges: Edges, edge: int) -> Index:
    """(use / 2, 2) half-edges of one edge, paired such that each pair bounds one wedge of the interior."""
    around = edges.around(edge)  # (use,)
    low, high = np.sort(edges.ends[edge])
    apex = mesh.faces[around // 3, (around + 2) % 3]  # third corner of each face
    axis = mesh.vertices[high] - mesh.vertices[low]
    across = np.linalg.svd(axis[None])[2][1:]  # (2, 3): axes perpendicular to the edge
    across[1] *= np.sign(np.linalg.det([*across, axis]))
    x, y = across @ (mesh.vertices[apex] - mesh.vertices[low]).T  # (use,) each
    # Seen against the axis, the interior is counter-clockwise of a face whose
    # half-edge is opposite to the axis. Such a face opens a wedge, and the next free
    # face of the other direction closes it, as parentheses match.
    opened: list[int] = []
    unopened: list[int] = []
    pairs: list[tuple[int, int]] = []
    for side in around[np.argsort(np.arctan2(y, x), kind="stable")]:
        if edges.tail[side] == high:
            opened.append(side)
        elif opened:
            pairs.append((opened.pop(), side))
        else:
            unopened.append(side)
    pairs += zip(reversed(opened), unopened, strict=True)
    return np.array(pairs, dtype=np.intp)


def _cut_in_the_middle(faces: Index, middle: Index) -> Index:
    """Bisect faces at the vertices in the middle of their sides, given as (m, 3) numbers, −1 for none."""
    while (cut := (middle >= 0).any(axis=1)).any():
        side = np.argmax(middle[cut] >= 0, axis=1)
        turn = (side[:, None] + np.arange(3)) % 3  # the side to be bisected comes first
        a, b, c = np.take_along_axis(faces[cut], turn, axis=1).T
        ab, bc, ca = np.take_along_axis(middle[cut], turn, axis=1).T
        whole = np.full_like(ab, -1)
        faces = np.concatenate([faces[~cut], np.column_stack([a, ab, c]), np.column_stack([ab, b, c])])
        middle = np.concatenate(
            [middle[~cut], np.column_stack([whole, whole, ca]), np.column_stack([whole, bc, whole])]
        )
    return faces
