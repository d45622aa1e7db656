"""Repairs that leave a note: nothing is put right in silence."""

from __future__ import annotations

import numpy as np

from pcretrieve.errors import DegenerateMeshError, ReconstructionError
from pcretrieve.surface.edges import edges_of, joined_by
from pcretrieve.surface.split import split_non_manifold
from pcretrieve.surface.topology import compact, components, orient_faces, twins
from pcretrieve.types import TriangleMesh

__all__ = [
    "ONE_SIDED",
    "collapse_flat_faces",
    "drop_repeated_faces",
    "largest_component",
    "outward",
    "repaired",
    "used_vertices",
]

Notes = tuple[str, ...]

ONE_SIDED = "the surface is one-sided, as a Möbius strip is, and bounds no body; scan it again or repair it"


def repaired(mesh: TriangleMesh) -> tuple[TriangleMesh, Notes]:
    """A mesh without bad faces, split where it is not manifold, one component, pointing outwards.

    A closed surface stays closed. Holes stay: they are the surface's business, not a triangulation's.

    Returns
    -------
    mesh : TriangleMesh
    notes : tuple of str

    Raises
    ------
    DegenerateMeshError
        If nothing is left, or the surface is one-sided.
    """
    used, loose = used_vertices(mesh)
    thick, flat = collapse_flat_faces(used)
    single, repeated = drop_repeated_faces(thick)
    if not len(single.faces):
        raise DegenerateMeshError(
            f"no face of {len(mesh.faces)} bounds anything: they are flat or cancel out"
        )
    oriented = orient_faces(single)
    if oriented is None:
        raise DegenerateMeshError(ONE_SIDED)
    agreed, n_turned = oriented
    turned = (f"turned {n_turned} faces of {len(agreed.faces)} to agree with their neighbours",)
    manifold = split_non_manifold(agreed)
    n_split = len(manifold.vertices) - len(agreed.vertices)
    split = (f"split {n_split} vertices where the surface was not manifold",)
    largest, dropped = largest_component(manifold)
    final, flipped = outward(largest)
    notes = (*loose, *flat, *repeated, *turned * (n_turned > 0), *split * (n_split > 0), *dropped, *flipped)
    return final, notes


def used_vertices(mesh: TriangleMesh) -> tuple[TriangleMesh, Notes]:
    """The mesh without the vertices that are in no face."""
    used = compact(mesh.vertices, mesh.faces)
    n_loose = len(mesh.vertices) - len(used.vertices)
    return (used, (f"dropped {n_loose} vertices that are in no face",)) if n_loose else (mesh, ())


def collapse_flat_faces(mesh: TriangleMesh) -> tuple[TriangleMesh, Notes]:
    """The mesh with the shortest side of each face without an area drawn together to a point.

    Their neighbours close up behind them, where dropping such faces would leave slits. The point is an end of
    their longest side, on which the third corner lies: the shape does not move.
    """
    n_faces, flat = len(mesh.faces), mesh.flat_faces
    while flat.any():  # each round leaves fewer faces
        corners = mesh.faces[flat]  # (f, 3)
        sides = mesh.vertices[corners] - mesh.vertices[np.roll(corners, -1, axis=1)]  # (f, 3, 3)
        length = np.linalg.norm(sides, axis=2)  # (f, 3): from corner k to corner k + 1
        row, shortest, longest = np.arange(len(corners)), length.argmin(axis=1), length.argmax(axis=1)
        point = joined_by(corners[row, shortest], corners[row, (shortest + 1) % 3], len(mesh.vertices))
        third = np.zeros(len(mesh.vertices), dtype=bool)
        third[corners[row, (longest + 2) % 3]] = True
        order = np.lexsort([third, point])
        _, first = np.unique(point[order], return_index=True)
        faces = point[mesh.faces]
        whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
        mesh = compact(mesh.vertices[order[first]], faces[whole])
        flat = mesh.flat_faces
    n_lost = n_faces - len(mesh.faces)
    return mesh, (f"collapsed {n_lost} of {n_faces} faces, flat ones and their neighbours",) * (n_lost > 0)


def drop_repeated_faces(mesh: TriangleMesh) -> tuple[TriangleMesh, Notes]:
    """The mesh with one face for each set of corners, or none where two copies lie back to back.

    Such copies are a fin, or a pillow, and enclose nothing; a closed surface stays closed without both. They
    are told from a face that was written twice, whichever way round, by their sides: these have an even
    number of faces. Where most faces are back to back the mesh is two-sided on purpose, and one of each two
    stays.
    """
    group = twins(mesh.faces)  # (m,)
    _, first, count = np.unique(group, return_index=True, return_counts=True)
    if len(first) == len(group):
        return mesh, ()
    a, b, c = mesh.faces.T
    handed = np.sign(a - b) * np.sign(b - c) * np.sign(c - a)  # (m,) ±1: which way round the corners run
    even = (edges_of(mesh.faces).crowd.reshape(-1, 3) % 2 == 0).all(axis=1)  # (m,)
    cancelled = (np.bincount(group, weights=handed) == 0) & even[first]
    if 2 * count[cancelled].sum() > len(group):
        cancelled[:] = False
    kept = np.sort(first[~cancelled])
    n_dropped = len(group) - len(kept)
    note = f"dropped {n_dropped} of {len(group)} faces that repeat others, or lie back to back"
    return compact(mesh.vertices, mesh.faces[kept]), (note,)


def largest_component(mesh: TriangleMesh, most: float = 1.0) -> tuple[TriangleMesh, Notes]:
    """The component of largest area, and what was dropped for it.

    Raises
    ------
    ReconstructionError
        If the second one has more than the share `most` of the whole area.
    """
    piece = components(mesh)  # (m,)
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
    return compact(mesh.vertices, mesh.faces[piece == 0]), (note,)


def outward(mesh: TriangleMesh) -> tuple[TriangleMesh, Notes]:
    """The mesh with positive volume; meant for closed ones."""
    if mesh.volume >= 0:
        return mesh, ()
    turned = TriangleMesh(mesh.vertices, mesh.faces[:, ::-1], mesh.provenance)
    return turned, ("turned the surface inside out",)
