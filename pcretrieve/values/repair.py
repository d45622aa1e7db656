"""Any mesh → a connected, oriented manifold, without flat or repeated faces and small components."""

from __future__ import annotations

import numpy as np

from pcretrieve.arrays import joined_by, unit_vectors
from pcretrieve.errors import DegenerateMeshError, ReconstructionError
from pcretrieve.values import topology
from pcretrieve.values.geometry import TriangleMesh, adjacency


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
    edges = topology.edges_of(mesh.faces)
    crowded = edges.use > 2
    agreed = np.flatnonzero(crowded & (edges.balance == 0))
    pairs = np.concatenate(
        [edges.pairs, *(_pairs_around(mesh, edges, edge) for edge in agreed.tolist())]
    )
    fan = topology.fans(edges, pairs)
    _, first = np.unique(fan, return_index=True)  # one corner of each fan
    vertices, faces = mesh.vertices[edges.tail[first]], fan.reshape(-1, 3)
    if crowded.any():
        # If both ends of an edge have one fan only, its pairs of faces still share the edge. Each pair then
        # gets a vertex of its own in the middle of the edge.
        still = topology.edges_of(faces)
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


def _pairs_around(mesh: TriangleMesh, edges: topology.Edges, edge: int) -> topology.Index:
    """(use / 2, 2) half-edges of one edge, paired such that each pair bounds one wedge of the interior."""
    around = edges.order[edges.starts[edge] :][: edges.use[edge]]  # (use,)
    low, high = np.sort(edges.ends[edge])
    apex = mesh.faces[around // 3, (around + 2) % 3]  # third corner of each face
    axis = mesh.vertices[high] - mesh.vertices[low]
    across = np.linalg.svd(axis[None])[2][1:]  # (2, 3): axes perpendicular to the edge
    across[1] *= np.sign(np.linalg.det([*across, axis]))
    x, y = across @ (mesh.vertices[apex] - mesh.vertices[low]).T  # (use,) each
    # Seen against the axis, the interior is counter-clockwise of a face whose half-edge is opposite to the
    # axis. Such a face opens a wedge, and the next free face of the other direction closes it, as parentheses
    # match.
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


def _cut_in_the_middle(faces: topology.Index, middle: topology.Index) -> topology.Index:
    """Bisect faces at the vertices in the middle of their sides, given as (m, 3) numbers, −1 for none."""
    while (cut := (middle >= 0).any(axis=1)).any():
        side = np.argmax(middle[cut] >= 0, axis=1)
        turn = (side[:, None] + np.arange(3)) % 3  # the side to be bisected comes first
        a, b, c = np.take_along_axis(faces[cut], turn, axis=1).T
        ab, bc, ca = np.take_along_axis(middle[cut], turn, axis=1).T
        whole = np.full_like(ab, -1)
        faces = np.concatenate(
            [faces[~cut], np.column_stack([a, ab, c]), np.column_stack([ab, b, c])]
        )
        middle = np.concatenate(
            [
                middle[~cut],
                np.column_stack([whole, whole, ca]),
                np.column_stack([whole, bc, whole]),
            ]
        )
    return faces


Notes = tuple[str, ...]

ONE_SIDED = "the surface is one-sided, as a Möbius strip is, and bounds no body; scan it again or repair it"


def repaired(mesh: TriangleMesh) -> tuple[TriangleMesh, Notes]:
    """A connected, oriented manifold without degenerate and duplicate faces, from any mesh.

    Non-manifold edges and vertices are split, all but the largest component are removed, and the faces are
    oriented outwards. A closed surface remains closed. Holes are not filled.
    """
    used, unused = used_vertices(mesh)
    thick, flat = collapse_flat_faces(used)
    single, repeated = drop_repeated_faces(thick)
    if not len(single.faces):
        raise DegenerateMeshError(
            f"no face of {len(mesh.faces)} bounds anything: they are flat or cancel out"
        )
    oriented = topology.orient_faces(single)
    if oriented is None:
        raise DegenerateMeshError(ONE_SIDED)
    agreed, n_turned = oriented
    turned = (
        f"turned {n_turned} faces of {len(agreed.faces)} to agree with their neighbours",
    )
    manifold = split_non_manifold(agreed)
    n_split = len(manifold.vertices) - len(agreed.vertices)
    split = (f"split {n_split} vertices where the surface was not manifold",)
    largest, dropped = largest_component(manifold)
    final, flipped = outward(largest)
    notes = (
        *unused,
        *flat,
        *repeated,
        *turned * (n_turned > 0),
        *split * (n_split > 0),
        *dropped,
        *flipped,
    )
    return final, notes


# Passes of Taubin's smoothing, and its two factors; and the ratio of the median angles between neighbouring
# faces before and after it beyond which vertices are noisy: see docs/decisions.md, noisy.
N_PASSES = 10
FACTORS = (0.5, -0.53)
NOISY = 2.5


def denoised(mesh: TriangleMesh) -> tuple[TriangleMesh, Notes]:
    """Smooth a mesh whose vertices are noisy, without shrinking it [1]_; others remain as they are.

    References
    ----------
    .. [1] G. Taubin, "A signal processing approach to fair surface design", SIGGRAPH 1995.
    """
    links, pairs = adjacency(mesh), topology.edges_of(mesh.faces).pairs // 3
    n_links, vertices = links.sum(axis=1)[:, np.newaxis], mesh.vertices
    for factor in N_PASSES * FACTORS:
        vertices = vertices + factor * (links @ vertices / n_links - vertices)
    smooth = TriangleMesh(vertices, mesh.faces, mesh.provenance)
    before, after = (_median_angle(one, pairs) for one in (mesh, smooth))
    if before <= NOISY * after:
        return mesh, ()
    angles = f"from {np.degrees(before):.0f} to {np.degrees(after):.0f} degrees"
    return smooth, (
        f"smoothed noisy vertices: the angle between neighbouring faces fell {angles} (median)",
    )


def _median_angle(mesh: TriangleMesh, pairs: topology.Index) -> float:
    """The median angle between the normals of pairs (p, 2) of faces; radians."""
    cosines = np.einsum("ij,ij->i", *unit_vectors(mesh.area_vectors)[pairs.T])
    return float(np.arccos(np.clip(np.median(cosines), -1, 1))) if len(cosines) else 0.0


def used_vertices(mesh: TriangleMesh) -> tuple[TriangleMesh, Notes]:
    """Remove unreferenced vertices."""
    used = topology.compact(mesh.vertices, mesh.faces)
    n_unused = len(mesh.vertices) - len(used.vertices)
    return (
        (used, (f"dropped {n_unused} vertices that are in no face",))
        if n_unused
        else (mesh, ())
    )


def collapse_flat_faces(mesh: TriangleMesh) -> tuple[TriangleMesh, Notes]:
    """Collapse the shortest side of each degenerate face.

    Removing the faces instead would leave slits between their neighbours. The side is collapsed to the end
    that it shares with the longest side of the face. The other end lies on the longest side too, so that the
    shape does not change.
    """
    n_faces, flat = len(mesh.faces), mesh.flat_faces
    while flat.any():  # terminates: each round removes faces
        corners = mesh.faces[flat]  # (f, 3)
        sides = (
            mesh.vertices[corners] - mesh.vertices[np.roll(corners, -1, axis=1)]
        )  # (f, 3, 3)
        length = np.linalg.norm(sides, axis=2)  # (f, 3): from corner k to corner k + 1
        row, shortest, longest = (
            np.arange(len(corners)),
            length.argmin(axis=1),
            length.argmax(axis=1),
        )
        point = joined_by(
            corners[row, shortest], corners[row, (shortest + 1) % 3], len(mesh.vertices)
        )
        third = np.zeros(len(mesh.vertices), dtype=bool)
        third[corners[row, (longest + 2) % 3]] = True
        order = np.lexsort([third, point])
        _, first = np.unique(point[order], return_index=True)
        faces = point[mesh.faces]
        whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
        mesh = topology.compact(mesh.vertices[order[first]], faces[whole])
        flat = mesh.flat_faces
    n_lost = n_faces - len(mesh.faces)
    return mesh, (
        f"collapsed {n_lost} of {n_faces} faces, flat ones and their neighbours",
    ) * (n_lost > 0)


def drop_repeated_faces(mesh: TriangleMesh) -> tuple[TriangleMesh, Notes]:
    """Remove duplicate faces, and pairs of faces with the same corners and opposite orientation.

    A pair of opposite faces encloses no volume, as in a fin, and a closed surface remains closed without it.
    It is distinguished from a face that was stored twice by the number of faces at its sides, which is even
    for a pair. If most faces are in such pairs, the mesh is a deliberate two-sided sheet, and one face of
    each pair is kept.
    """
    group = topology.face_groups(mesh.faces)  # (m,)
    _, first, count = np.unique(group, return_index=True, return_counts=True)
    if len(first) == len(group):
        return mesh, ()
    a, b, c = mesh.faces.T
    # (m,) ±1: parity of the order of the corners.
    handed = np.sign(a - b) * np.sign(b - c) * np.sign(c - a)
    even = (topology.edges_of(mesh.faces).crowd.reshape(-1, 3) % 2 == 0).all(
        axis=1
    )  # (m,)
    cancelled = (np.bincount(group, weights=handed) == 0) & even[first]
    if 2 * count[cancelled].sum() > len(group):
        cancelled[:] = False
    kept = np.sort(first[~cancelled])
    n_dropped = len(group) - len(kept)
    note = f"dropped {n_dropped} of {len(group)} faces that repeat others, or lie back to back"
    return topology.compact(mesh.vertices, mesh.faces[kept]), (note,)


def largest_component(
    mesh: TriangleMesh, most: float = 1.0
) -> tuple[TriangleMesh, Notes]:
    """The connected component of largest area."""
    piece = topology.components(mesh)  # (m,)
    areas = np.bincount(piece, weights=mesh.face_areas)
    if len(areas) < 2:
        return mesh, ()
    share = areas / areas.sum()
    if share[1] > most:
        raise ReconstructionError(
            f"the scan holds more than one body: the second has {share[1]:.0%} of the area, more than "
            f"surface.max_discarded = {most:.0%}; give each body a file of its own"
        )
    note = f"dropped {len(areas) - 1} smaller components with {share[1:].sum():.2%} of the area"
    return topology.compact(mesh.vertices, mesh.faces[piece == 0]), (note,)


def outward(mesh: TriangleMesh) -> tuple[TriangleMesh, Notes]:
    """Orient a closed mesh outwards."""
    if mesh.volume >= 0:
        return mesh, ()
    turned = TriangleMesh(mesh.vertices, mesh.faces[:, ::-1], mesh.provenance)
    return turned, ("turned the surface inside out",)
