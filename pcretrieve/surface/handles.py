"""A body with the topology asked for, grown along the points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pcretrieve.options import SurfaceOptions
from pcretrieve.scan.outside import FARTHEST, Outside, distances
from pcretrieve.surface.edges import joined_by
from pcretrieve.surface.growth import grown
from pcretrieve.surface.marching import marched
from pcretrieve.types import TriangleMesh

__all__ = ["with_topology"]

Mask = NDArray[np.bool_]
Voxels = NDArray[np.float32]

# How much deeper than its distance to the nearest point a cell may count; cells. Little, so that the way
# through a contact, between the points of two skins, is narrower than the way through a thin limb.
SKIN_DEPTH = 0.3

# Cells that share a corner are less than this apart, those that do not are more.
CORNER = 1.8

# A cut this thick beside the body's greatest depth went through a true handle.
HANDLE = 0.6


def with_topology(
    inside: Mask, walls: Mask, outside: Outside, options: SurfaceOptions, notes: list[str]
) -> tuple[Mask, NDArray[np.intp]]:
    """The cells with the genus asked for, and those that had to go, (k, 3).

    `walls`, (3, a, b, c), are ways between cells that pass through the points' skin.
    """
    if options.genus == "free":
        return inside, np.zeros((0, 3), dtype=np.intp)
    depth = distances(~inside, np.inf)
    # Where limbs touch, points lie between them: the way through is narrow there.
    to_points = np.where(outside.distance < FARTHEST, outside.distance + SKIN_DEPTH, np.inf)
    priority = np.minimum(depth, to_points).astype(np.float32)
    body = grown(inside, priority, walls)
    if options.genus not in ("sphere", 0):
        body = _with_handles(inside, body, depth, options.genus, notes)
    return body, np.argwhere(inside & ~body)


def _with_handles(inside: Mask, body: Mask, depth: Voxels, genus: str | int, notes: list[str]) -> Mask:
    """The body with its thickest cuts undone, each of which closes one handle.

    A contact is thin beside the limbs that meet in it, a true handle is not: ``auto`` undoes the cuts that
    reach `HANDLE` of the body's own greatest depth. A number undoes as many, thickest first.
    """
    left_out = np.argwhere(inside & ~body)  # (k, 3)
    cut_of = _pieces(left_out)
    n_cuts = int(cut_of.max(initial=-1)) + 1
    thickness = np.zeros(n_cuts)
    np.maximum.at(thickness, cut_of, depth[tuple(left_out.T)])
    wanted = n_cuts if genus == "auto" else int(genus)
    made = 0
    for cut in np.argsort(-thickness):
        if made == wanted or (genus == "auto" and thickness[cut] < HANDLE * depth.max()):
            break
        cells = left_out[cut_of == cut]
        low = cells.min(axis=0) - 2
        box = tuple(slice(a, b) for a, b in zip(low, cells.max(axis=0) + 3, strict=True))
        closed = body[box].copy()
        closed[tuple((cells - low).T)] = True
        change = _euler(closed) - _euler(body[box])
        if change == -2:  # one handle, and nothing else
            body[box] = closed
            made += 1
    if genus == "auto" and made:
        notes.append(f"kept {made} handles as thick as the body round them; genus = 'sphere' would cut them")
    elif genus != "auto" and made < int(genus):
        notes.append(f"only {made} of {genus} handles were found")
    return body


def _pieces(cells: NDArray[np.intp]) -> NDArray[np.intp]:
    """(k,) numbers of the connected pieces that (k, 3) cells belong to; corners connect."""
    from scipy.spatial import cKDTree

    if not len(cells):
        return np.zeros(0, dtype=np.intp)
    a, b = cKDTree(cells).query_pairs(CORNER, output_type="ndarray").T
    return joined_by(a, b, len(cells))


def _euler(body: Mask) -> int:
    """Euler characteristic of the surface of some cells, as `marched` makes it."""
    padded = np.pad(body, 1)
    if not padded.any():
        return 0
    vertices, faces = marched(padded)
    return TriangleMesh(vertices, faces).euler_characteristic
