"""Cutting a surface apart until it is a manifold."""

from __future__ import annotations

import numpy as np

from pcretrieve.surface.edges import Edges, Index, edges_of, fans
from pcretrieve.types import TriangleMesh

__all__ = ["split_non_manifold"]


def split_non_manifold(mesh: TriangleMesh) -> TriangleMesh:
    """Cut a surface apart where more than two faces share an edge, or two fans share a vertex.

    Around such an edge the faces are sorted by angle and paired so that each pair bounds one wedge of the
    inside; each vertex then gets one copy per fan of paired faces. The shape does not move. A closed,
    outward-oriented input comes back as a closed manifold (Guéziec et al., "Cutting and stitching",
    IEEE TVCG 2001, with the stitching decided by the solid). Faces around an edge that do not agree on an
    inside, as where three sheets meet, are cut apart and leave a boundary.
    """
    edges = edges_of(mesh.faces)
    crowded = edges.use > 2
    agreed = np.flatnonzero(crowded & (edges.balance == 0))
    pairs = np.concatenate([edges.pairs, *(_pairs_around(mesh, edges, edge) for edge in agreed.tolist())])
    fan = fans(edges, pairs)
    _, first = np.unique(fan, return_index=True)  # a corner of each fan
    vertices, faces = mesh.vertices[edges.tail[first]], fan.reshape(-1, 3)
    if crowded.any():
        # Both ends of an edge may stay in one fan each, and its pairs on one edge then: each pair gets a
        # vertex of its own in the middle.
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
    """(use / 2, 2) half-edges of one edge, paired so that each pair bounds one wedge of the inside."""
    around = edges.around(edge)  # (use,)
    low, high = np.sort(edges.ends[edge])
    apex = mesh.faces[around // 3, (around + 2) % 3]  # third corner of each face
    axis = mesh.vertices[high] - mesh.vertices[low]
    across = np.linalg.svd(axis[None])[2][1:]  # (2, 3): axes at right angles to the edge
    across[1] *= np.sign(np.linalg.det([*across, axis]))
    x, y = across @ (mesh.vertices[apex] - mesh.vertices[low]).T  # (use,) each
    # Seen against the axis, the inside lies anticlockwise of a face whose half-edge runs against it. What
    # such a face opens, the next free one of the others closes: like parentheses on a circle.
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
    """Cut faces in two at vertices in the middle of their sides: (m, 3), -1 where a side stays whole."""
    while (cut := (middle >= 0).any(axis=1)).any():
        side = np.argmax(middle[cut] >= 0, axis=1)
        turn = (side[:, None] + np.arange(3)) % 3  # so that the side to be cut comes first
        a, b, c = np.take_along_axis(faces[cut], turn, axis=1).T
        ab, bc, ca = np.take_along_axis(middle[cut], turn, axis=1).T
        whole = np.full_like(ab, -1)
        faces = np.concatenate([faces[~cut], np.column_stack([a, ab, c]), np.column_stack([ab, b, c])])
        middle = np.concatenate(
            [middle[~cut], np.column_stack([whole, whole, ca]), np.column_stack([whole, bc, whole])]
        )
    return faces
