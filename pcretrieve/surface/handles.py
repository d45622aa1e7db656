"""The genus of a body: region growing removes all handles, and true handles are restored."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pcretrieve.options import SurfaceOptions
from pcretrieve.points.voxels import FARTHEST, Mask, Outside, Voxels, distances
from pcretrieve.surface.edges import joined_by
from pcretrieve.surface.growth import grown
from pcretrieve.surface.marching import marched
from pcretrieve.values import TriangleMesh

__all__ = ["with_topology"]


# Largest amount by which the depth of a voxel, as the priority of region growing, may exceed its distance to
# the nearest point; in voxels. It is small, so that a contact, with points of both surfaces in it, has a
# lower priority than the interior of a thin limb.
SKIN_DEPTH = 0.3

# Voxels are 26-adjacent if their centres are less than this apart: √3 < 1.8 < 2.
CORNER = 1.8

# Smallest thickness of a cut, relative to the greatest depth of the body, for its handle to be a true one.
HANDLE = 0.6


def with_topology(
    inside: Mask, walls: Mask, outside: Outside, options: SurfaceOptions, notes: list[str]
) -> tuple[Mask, NDArray[np.intp]]:
    """The body with the requested genus.

    inside: (a, b, c) bool, voxels that may belong to the body; False on the border of the grid.
    walls: (3, a, b, c) bool, whether the link from a voxel to the next along each axis crosses a surfel, from
        `contacts.walls`.
    Returns body : (a, b, c) bool: the voxels of the body.
    Returns cuts : (k, 3) int: the voxels that were removed.
    """
    if options.genus == "free":
        return inside, np.zeros((0, 3), dtype=np.intp)
    depth = distances(~inside, np.inf)
    body = grown(inside, _priority(depth, outside.distance), walls)
    if options.genus not in ("sphere", 0):
        body = _with_handles(inside, body, depth, options.genus, notes)
    return body, _voxels(inside & ~body)


@njit(cache=True)
def _priority(depth: Voxels, to_points: Voxels) -> Voxels:
    """The depth of each voxel, but little more than its distance to the points."""
    # At a contact there are points between the limbs: the priority is low there.
    priority: Voxels = depth.copy()
    values, distance = priority.ravel(), to_points.ravel()
    for cell in range(len(values)):
        if distance[cell] < FARTHEST:
            values[cell] = min(values[cell], distance[cell] + np.float32(SKIN_DEPTH))
    return priority


def _voxels(mask: Mask) -> NDArray[np.intp]:
    """(k, 3) voxels of a set."""
    return np.stack(np.unravel_index(np.flatnonzero(mask), mask.shape), axis=1)


def _with_handles(inside: Mask, body: Mask, depth: Voxels, genus: str | int, notes: list[str]) -> Mask:
    """The body after restoring the handles with the thickest cuts, as many as the genus requires."""
    # A contact is thin compared with the limbs, a true handle is not: ``auto`` restores the handles whose
    # cuts are at least `HANDLE` as deep as the body. Each component of the removed voxels is a cut.
    left_out = _voxels(inside & ~body)  # (k, 3)
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
        if change == -2:  # exactly one handle
            body[box] = closed
            made += 1
    if genus == "auto" and made:
        notes.append(f"kept {made} handles as thick as the body round them; genus = 'sphere' would cut them")
    elif genus != "auto" and made < int(genus):
        notes.append(f"only {made} of {genus} handles were found")
    return body


def _pieces(cells: NDArray[np.intp]) -> NDArray[np.intp]:
    """(k,) number of the 26-connected component of each of (k, 3) voxels."""
    from scipy.spatial import cKDTree

    if not len(cells):
        return np.zeros(0, dtype=np.intp)
    a, b = cKDTree(cells).query_pairs(CORNER, output_type="ndarray").T
    return joined_by(a, b, len(cells))


def _euler(body: Mask) -> int:
    """Euler characteristic of the surface that `marched` makes of a set of voxels."""
    padded = np.pad(body, 1)
    if not padded.any():
        return 0
    vertices, faces = marched(padded)
    return TriangleMesh(vertices, faces).euler_characteristic
