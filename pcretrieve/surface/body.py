"""Oriented points → the enclosed body as a set of voxels → its closed surface.

This is the surface method ``growth``. Its steps are:

1. Flood fill finds the voxels outside the body (`points.voxels`).
2. Voxels near the points get a signed distance to the surface (`field`).
3. Voxels far from the points, in holes of the scan, are classified by a coarse surface (`coarse`, `caps`).
4. Voxels between two parts of the body that touch are removed, unless the genus is ``free``; components that
   a hole of the scan has separated are connected (`parts`).
5. Topology-preserving region growing removes handles that the body does not have (`growth`).
6. The boundary of the voxels is triangulated, smoothed and simplified (`marching`, `values.simplify`).
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.arrays import joined_by
from pcretrieve.errors import ReconstructionError
from pcretrieve.options import SurfaceOptions
from pcretrieve.points.neighbors import (
    PLANE_NEIGHBORS,
    Neighborhoods,
    neighborhoods,
    noise,
    spacing,
)
from pcretrieve.points.voxels import Outside, Voxels, flood
from pcretrieve.surface.caps import NO_CAP, Capped, faces_ground, points_on
from pcretrieve.surface.coarse import coarse_surface, crossings, filled
from pcretrieve.surface.fairing import faces_at, faired, with_ring
from pcretrieve.surface.field import distance_field, folded, hidden_below, normals_of
from pcretrieve.surface.growth import with_topology
from pcretrieve.surface.marching import LEAST_SHARE, Crossings, crossed, marched, smoothed
from pcretrieve.surface.parts import (
    CONTINUED,
    contact_layer,
    joined,
    rims,
    walls,
    without_grooves,
)
from pcretrieve.surface.poisson import interpolated
from pcretrieve.values import FloatArray, Grid, Mask, PointCloud, Step, TriangleMesh
from pcretrieve.values.simplify import simplified
from pcretrieve.values.topology import SurfaceMarks, edges_of

# Largest fraction of the interior of the coarse surface that the flood fill may reach. If it reaches more, it
# has leaked through a hole, and is repeated with the radius of closed holes times each factor in turn.
MOST_LEAKED = 0.02
WIDER = (1.4, 2.0)

# Rounds of Taubin smoothing of the surface that no points support: in holes, at cuts and at bridges.
SMOOTHING = 8

# Distance from a cap, relative to the diagonal, within which normals are compared with the direction to the
# outside; and the cosine below which they are turned.
NEAR_CAP = 0.04
OPPOSED = 0.3

# Smallest number of vertices of a patch that is faired. In smaller ones smoothing is enough.
LEAST_FAIRED = 40

# Largest ratio of the areas of a patch after and before it is faired. A larger one has folded.
MOST_STRETCHED = 2.5

# Largest fraction of the vertices that no points support.
MOST_INVENTED = 0.3

# Largest `_one_sidedness` of the surface that no points support.
MOST_ONE_SIDED = 0.15

# Edge of the voxels in units of the noise of the points, and its limits relative to the diagonal. Small
# voxels separate fingers if the points are exact, but give a rough surface if the points are noisy.
NOISES = 6.5
FINEST = 0.0033
COARSEST = 0.0045

# Edge of the voxels of the first, the second and the third surface, and so on in turn; relative to the edge
# in the options. Small voxels separate fingers but open holes where the sampling is sparse, large voxels do
# the reverse; the surfaces differ where the result depends on the edge.
CELLS = (1.0, 4 / 3, 3 / 4)

# Shift of the grid of each further surface relative to the one before, modulo one voxel. Its multiples are a
# low-discrepancy sequence (Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018).
SHIFT = np.array([0.8191725134, 0.6710436067, 0.5497004779])


def body_surfaces(
    cloud: PointCloud, options: SurfaceOptions, neighbors: Neighborhoods
) -> Iterator[tuple[TriangleMesh, SurfaceMarks]]:
    """Reconstruct the surface of the body that oriented points enclose, on several grids.

    Where the points are sparse beside the voxels, points are interpolated first. Near the points a voxel is
    inside if the signed distance to the algebraic sphere fitted to the points is negative. Elsewhere, in
    holes of the scan, it is inside if it is inside a coarse surface. A voxel that the flood fill of the
    outside reaches is never inside.

    Each surface, closed, connected and manifold, is made on a grid of another voxel edge and another origin:
    see `CELLS`.

    neighbors: the `PLANE_NEIGHBORS` nearest of all points, or more.
    """
    started = time.perf_counter()
    some = neighbors.some()
    least = spacing(some)
    size = _cell(cloud, some, options)
    n_measured = len(cloud.points)
    cloud = interpolated(cloud, some, cell=max(size, least))
    if len(cloud.points) > n_measured:
        neighbors = neighborhoods(cloud.points, PLANE_NEIGHBORS + 1)
    n_between = len(cloud.points) - n_measured
    coarse, cloud = coarse_surface(cloud, options, neighbors, spacing=least)
    n_continued = len(cloud.points) - n_measured - n_between
    del neighbors
    notes = []
    if n_between:
        notes.append(
            f"interpolated {n_between} points where the {n_measured} points are sparse"
        )
    if n_continued:
        notes.append(f"continued a limb across a gap by {n_continued} points")
    for number in range(options.reconstructions):
        cell = max(CELLS[number % len(CELLS)] * size, least)
        mesh, marks, step = _body_surface(
            cloud, coarse, cell, number * SHIFT % 1, options
        )
        seconds = time.perf_counter() - started
        step = replace(step, seconds=seconds, notes=(*notes, *step.notes))
        yield TriangleMesh(mesh.vertices, mesh.faces, (*cloud.provenance, step)), marks
        started = time.perf_counter()


def _body_surface(
    cloud: PointCloud,
    coarse: Capped,
    cell: float,
    shift: FloatArray,
    options: SurfaceOptions,
) -> tuple[TriangleMesh, SurfaceMarks, Step]:
    notes: list[str] = []
    body = _body(cloud, coarse, cell, shift, options, notes)
    mesh, unsupported, in_hole = _surface(body, coarse)
    invented = _invented(mesh, unsupported)
    mesh = _fair(mesh, in_hole, cloud)
    final = simplified(mesh, options.target_faces)
    step = Step(
        "surface",
        0.0,
        {
            "points": len(cloud.points),
            "cells": int(body.voxels.sum()),
            "cut_cells": len(body.cuts),
            "bridge_cells": len(body.bridges),
            "invented": invented,
            "faces_grid": len(mesh.faces),
            "faces": len(final.faces),
            "euler": final.euler_characteristic,
        },
        tuple(notes),
    )
    base = points_on(coarse.surface, coarse.base, cell)
    cuts, bridges = body.grid.centres(body.cuts), body.grid.centres(body.bridges)
    return final, SurfaceMarks(cuts, bridges, base), step


class Sides(NamedTuple):
    """Which voxels are outside a body, and which inside.

    cloud: the points, whose normals the flood fill may have turned.
    outside: what the flood fill reached.
    distance: signed distance to the points; in voxels, NaN far from them.
    core: the voxels far from the points that are inside the coarse surface, which near them can be inaccurate
        by a voxel.
    """

    cloud: PointCloud
    outside: Outside
    distance: Voxels
    core: Mask

    @property
    def inside(self) -> Mask:
        """The voxels that may belong to the body."""
        return (self.core | (self.distance < 0)) & ~self.outside.reached

    @property
    def leaks(self) -> bool:
        """Whether the flood fill came in by a hole."""
        n_reached = (self.outside.reached & self.core).sum()
        return bool(n_reached > MOST_LEAKED * self.core.sum())


def _sides_of(cloud: PointCloud, outside: Outside, coarse: Capped) -> Sides:
    distance = distance_field(cloud, outside)
    core = filled(coarse.surface, outside.grid) & np.isnan(distance)
    return Sides(cloud, outside, distance, core)


def _sides(
    cloud: PointCloud,
    coarse: Capped,
    cell: float,
    shift: FloatArray,
    options: SurfaceOptions,
    notes: list[str],
) -> Sides:
    """Tell both sides of a body apart, by a flood fill that closes larger holes until it does not leak."""
    # A cap stops the flood fill as points do.
    caps = points_on(coarse.surface, coarse.cap != NO_CAP, cell)
    walled = np.concatenate([cloud.points, caps])
    for wider in (1.0, *WIDER):
        outside = flood(
            walled,
            coarse.surface.vertices,
            cell=cell,
            gap=options.gap * wider * cloud.diagonal,
            shift=shift,
            deepest=hidden_below(cloud.diagonal, cell) + 1,  # interpolated between voxels
        )
        cloud = _turned(cloud, caps, outside)
        sides = _sides_of(cloud, outside, coarse)
        if not sides.leaks:
            return sides
    notes.append("the flood fill of the outside leaked into the body and was not used")
    nothing, nowhere = np.zeros_like(outside.reached), np.zeros_like(outside.depth)
    return _sides_of(cloud, replace(outside, reached=nothing, depth=nowhere), coarse)


class Body(NamedTuple):
    """The voxels of a body, and those from which it was made.

    voxels: (a, b, c) bool, the body after region growing.
    inside: (a, b, c) bool, the body before it.
    parted: (a, b, c) bool, the voxels removed by `contact_layer`.
    distance: signed distance to the points; in voxels, NaN far from them.
    cuts, bridges: (k, 3) and (j, 3), the voxels that were removed and added, as in `SurfaceMarks`.
    """

    grid: Grid
    voxels: Mask
    inside: Mask
    parted: Mask
    distance: Voxels
    cuts: NDArray[np.intp]
    bridges: NDArray[np.intp]


def _body(
    cloud: PointCloud,
    coarse: Capped,
    cell: float,
    shift: FloatArray,
    options: SurfaceOptions,
    notes: list[str],
) -> Body:
    """The voxels inside, without contacts of parts and with the requested genus."""
    sides = _sides(cloud, coarse, cell, shift, options, notes)
    cloud, grid, distance = sides.cloud, sides.outside.grid, sides.distance
    inside, to_points = sides.inside, sides.outside.distance
    parted, links = np.zeros_like(inside), np.zeros((3, 0, 0, 0), dtype=bool)
    if options.genus != "free":
        folds = folded(cloud, sides.outside, inside)
        del sides  # most memory is needed next
        parted, links = _contacts(cloud, folds, inside, to_points, grid)
        inside &= ~parted
    inside, bridges = joined(inside, cloud.points, grid, options, notes)
    if not inside.any():
        raise ReconstructionError(f"{len(cloud.points)} points enclose nothing")
    body, cuts = with_topology(inside, links, to_points, options, notes)
    return Body(grid, body, inside, parted, distance, cuts, bridges)


def _contacts(
    cloud: PointCloud, folds: Mask, inside: Mask, to_points: Voxels, grid: Grid
) -> tuple[Mask, Mask]:
    """The voxels of contacts, without grooves, and the (3, a, b, c) links that cross a surfel.

    Folds are no contacts: a closed mouth does not part the head.
    """
    links = _walls(cloud.select(~folds), grid)
    continued = _continued(cloud, grid, to_points)
    parted = contact_layer(inside, links, continued, to_points)
    at = grid.coordinates(cloud.points)
    parted = without_grooves(parted, inside, at, normals_of(cloud), to_points)
    if continued.any():
        links |= continued
    if folds.any():
        links |= _walls(cloud.select(folds), grid)
    return parted, links


def _turned(cloud: PointCloud, caps: FloatArray, outside: Outside) -> PointCloud:
    """The points, whose normals near caps point to the outside that the flood fill finds beside the caps.

    The first flood fill, by which normals were oriented, can leak through a large hole, and turn those near
    its rim. With caps it cannot, so that the radius of other holes, and of gaps between fingers, stays small.
    """
    if not len(caps) or cloud.viewpoints is not None:
        return cloud
    from scipy.spatial import cKDTree

    reach = NEAR_CAP * cloud.diagonal
    distance, _ = cKDTree(caps).query(cloud.points, distance_upper_bound=reach)
    near = np.flatnonzero(distance < reach)
    normals = normals_of(cloud).copy()
    towards = outside.direction_at(cloud.points[near])
    opposed = near[np.einsum("ij,ij->i", normals[near], towards) < -OPPOSED]
    normals[opposed] *= -1
    return replace(cloud, normals=normals)


def _cell(cloud: PointCloud, neighbors: Neighborhoods, options: SurfaceOptions) -> float:
    """Edge of the voxels of the first surface; unit of the file."""
    if options.cell != "auto":
        return options.cell * cloud.diagonal
    size = NOISES * noise(cloud.points, neighbors)
    return float(np.clip(size, FINEST * cloud.diagonal, COARSEST * cloud.diagonal))


def _walls(cloud: PointCloud, grid: Grid) -> Mask:
    return walls(grid.coordinates(cloud.points), normals_of(cloud), grid.shape)


def _continued(cloud: PointCloud, grid: Grid, to_points: Voxels) -> Mask:
    """The links that cross a wall continued inwards from the rim of a contact, if sensors left it unseen."""
    if cloud.viewpoints is None:
        return np.zeros((3, 1, 1, 1), dtype=bool)
    middles, directions = rims(
        grid.coordinates(cloud.points), normals_of(cloud), to_points
    )
    return walls(middles, directions, grid.shape, CONTINUED)


class Links(NamedTuple):
    """The vertices of a surface on the links of voxels along one axis: where, and of which kind.

    invented: (k,) bool, those that no signed distance places.
    unseen: (k,) bool, those of them that no points support: not those beside voxels of contacts, because
        there are points near them.
    in_hole: (k,) bool, those of these that close a hole of the scan, not a cut or a bridge.
    """

    crossings: Crossings
    invented: Mask
    unseen: Mask
    in_hole: Mask


def _links(body: Body, coarse: Capped, axis: int, here: NDArray[np.intp]) -> Links:
    """The vertices on the links from (k, 3) voxels to the next along an axis.

    Where the signed distance changes its sign as the body does, the vertex is at the linearly interpolated
    zero. Elsewhere it is at the crossing of the coarse surface, if there is one, else in the middle.
    """
    low = np.ravel_multi_index(tuple(here.T), body.voxels.shape)
    high = low + int(np.prod(body.voxels.shape[axis + 1 :]))
    inside, parted = body.inside.ravel(), body.parted.ravel()
    at_low, at_high = (body.distance.ravel()[end] for end in (low, high))
    changes = inside[low] != inside[high]
    believed = changes & ((at_low < 0) == inside[low]) & ((at_high < 0) == inside[high])
    believed &= np.isfinite(at_low) & np.isfinite(at_high)
    zero = np.divide(
        at_low, at_low - at_high, out=np.full(len(here), 0.5), where=believed
    )
    crossing = crossings(coarse.surface, body.grid, axis).ravel()[low]
    guess = np.where(changes & np.isfinite(crossing), crossing, 0.5)
    share = np.clip(np.where(believed, zero, guess), LEAST_SHARE, 1 - LEAST_SHARE)
    unseen = ~believed & ~parted[low] & ~parted[high]
    return Links(Crossings(here, share), ~believed, unseen, unseen & changes)


def _surface(body: Body, coarse: Capped) -> tuple[TriangleMesh, Mask, Mask]:
    """The boundary surface of a body, smoothed where no signed distance places it.

    Returns mesh, unseen, in_hole: the surface, and two masks (n,) of its vertices, as in `Links`.
    """
    links = [
        _links(body, coarse, axis, here) for axis, here in enumerate(crossed(body.voxels))
    ]
    vertices, faces = marched(body.voxels, [each.crossings for each in links])
    invented, unseen, in_hole = (
        np.concatenate(parts) for parts in zip(*(each[1:] for each in links), strict=True)
    )
    moved = smoothed(vertices, faces, np.flatnonzero(invented), SMOOTHING)
    # The vertices after those on links, inside cubes of the grid, are few.
    rest = (0, len(vertices) - len(unseen))
    mesh = TriangleMesh(body.grid.centres(moved), faces)
    return mesh, np.pad(unseen, rest), np.pad(in_hole, rest)


def _fair(mesh: TriangleMesh, in_hole: Mask, cloud: PointCloud) -> TriangleMesh:
    """The surface, after patches in holes of the scan have been faired, but for those on the ground."""
    if np.count_nonzero(in_hole) < LEAST_FAIRED:
        return mesh
    vertices, faces = mesh.vertices, mesh.faces
    links = edges_of(faces_at(in_hole, faces)).ends
    links = links[in_hole[links].all(axis=1)]
    patch = joined_by(links[:, 0], links[:, 1], len(vertices))
    sizes = np.bincount(patch[in_hole], minlength=1)
    for number in np.flatnonzero(sizes >= LEAST_FAIRED):
        own = in_hole & (patch == number)
        around = faces_at(own, faces)
        before = TriangleMesh(vertices, around)
        axis = before.area_vectors.sum(axis=0)
        if faces_ground(axis / np.linalg.norm(axis), cloud):
            continue
        moved = faired(vertices, faces, with_ring(own, faces))
        if TriangleMesh(moved, around).area < MOST_STRETCHED * before.area:
            vertices = moved
    return TriangleMesh(vertices, faces)


def _invented(mesh: TriangleMesh, invented: Mask) -> float:
    """The fraction of the vertices that no points support, if it is small enough for a body."""
    share = float(invented.mean())
    one_sided = _one_sidedness(mesh, invented) > MOST_ONE_SIDED
    if share > MOST_INVENTED or one_sided:
        raise ReconstructionError(
            f"the points must surround a body, {share:.0%} of its surface had to be invented"
            f"{', on one side' if one_sided else ''}: "
            "scan the sides that are missing, or merge this view with others"
        )
    return share


def _one_sidedness(mesh: TriangleMesh, invented: Mask) -> float:
    """The norm of the sum of the area vectors of unsupported faces, relative to the whole area."""
    # The area vectors of the whole surface sum up to zero. The ratio is 0 if the normals of the unsupported
    # part balance, and 1/2 if this part is one side of a sheet and the points are the other.
    share = invented[mesh.faces] @ np.full(3, 1 / 3)  # (m,)
    vectors = mesh.area_vectors
    area = np.sqrt(vectors**2 @ np.ones(3)).sum()
    return float(np.linalg.norm(share @ vectors) / area)
