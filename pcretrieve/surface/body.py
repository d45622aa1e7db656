"""Oriented points → the enclosed body as a set of voxels → its closed surface.

This is the surface method ``growth``. Its steps are:

1. Flood fill finds the voxels outside the body (`points.outside`).
2. Voxels near the points get a signed distance to the surface (`field`).
3. Voxels far from the points, in holes of the scan, are classified by a coarse surface (`coarse`, `caps`).
4. Voxels between two parts of the body that touch are removed, unless the genus is ``free``; components that
   a hole of the scan has separated are connected (`parts`).
5. Topology-preserving region growing removes handles that the body does not have (`growth`).
6. The boundary of the voxels is triangulated, smoothed and simplified (`marching`, `simplify`).
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from pcretrieve.errors import ReconstructionError
from pcretrieve.options import SurfaceOptions
from pcretrieve.points.density import interpolated
from pcretrieve.points.grid import Grid, Mask, Voxels, joined_by
from pcretrieve.points.neighbors import (
    PLANE_NEIGHBORS,
    Neighborhoods,
    neighborhoods,
    noise,
    spacing,
)
from pcretrieve.points.outside import Outside, flood
from pcretrieve.surface.caps import NO_CAP, Capped, faces_ground, points_on
from pcretrieve.surface.coarse import coarse_surface, crossings, filled
from pcretrieve.surface.fairing import faces_at, faired, with_ring
from pcretrieve.surface.field import distance_field, folded, hidden_below, normals_of
from pcretrieve.surface.growth import with_topology
from pcretrieve.surface.marching import LEAST_SHARE, Crossings, crossed, marched, smoothed
from pcretrieve.surface.parts import CONTINUED, contact_layer, joined, rims, walls
from pcretrieve.surface.simplify import simplified
from pcretrieve.surface.topology import edges_of
from pcretrieve.values import FloatArray, PointCloud, Step, TriangleMesh

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
    base: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))

    def moved(self, by: FloatArray) -> SurfaceMarks:
        """All places, translated."""
        return SurfaceMarks(self.cuts + by, self.bridges + by, self.base + by)


def body_surfaces(
    cloud: PointCloud, options: SurfaceOptions, neighbors: Neighborhoods | None = None
) -> Iterator[tuple[TriangleMesh, SurfaceMarks]]:
    """Reconstruct the surface of the body that oriented points enclose, on several grids.

    Where the points are sparse beside the voxels, points are interpolated first. Near the points a voxel is
    inside if the signed distance to the algebraic sphere fitted to the points is negative. Elsewhere, in
    holes of the scan, it is inside if it is inside a coarse surface. A voxel that the flood fill of the
    outside reaches is never inside.

    Each surface, closed, connected and manifold, is made on a grid of another voxel edge and another origin:
    see `CELLS`.

    neighbors: the `PLANE_NEIGHBORS` nearest of all points, or more, if they are known.
    """
    started = time.perf_counter()
    if neighbors is None:
        neighbors = neighborhoods(cloud.points, PLANE_NEIGHBORS + 1)
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
    for number in range(options.reconstructions):
        cell = max(CELLS[number % len(CELLS)] * size, least)
        mesh, marks, step = _body_surface(
            cloud, coarse, cell, number * SHIFT % 1, options
        )
        step = replace(step, seconds=time.perf_counter() - started)
        if n_continued:
            note = f"continued a limb across a gap by {n_continued} points"
            step = replace(step, notes=(note, *step.notes))
        if n_between:
            note = f"interpolated {n_between} points where the {n_measured} points are sparse"
            step = replace(step, notes=(note, *step.notes))
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
    deepest = hidden_below(cloud.diagonal, cell) + 1  # interpolated between voxels
    # A cap stops the flood fill as points do.
    caps = points_on(coarse.surface, coarse.cap != NO_CAP, cell)
    walled = np.concatenate([cloud.points, caps])
    further = coarse.surface.vertices
    for gap in (options.gap, *(options.gap * wider for wider in WIDER)):
        outside = flood(
            walled,
            further,
            cell=cell,
            gap=gap * cloud.diagonal,
            shift=shift,
            deepest=deepest,
        )
        coarse_inside = filled(coarse.surface, outside.grid)
        cloud = _turned(cloud, caps, outside)
        distance = distance_field(cloud, outside)
        # Far from the points only: near them the coarse surface can be inaccurate by a voxel.
        core = coarse_inside & np.isnan(distance)
        if (outside.reached & core).sum() <= MOST_LEAKED * core.sum():
            break
    else:
        outside = replace(
            outside,
            reached=np.zeros_like(outside.reached),
            depth=np.zeros_like(outside.depth),
        )
        distance = distance_field(cloud, outside)
        notes.append(
            "the flood fill of the outside leaked into the body and was not used"
        )
    grid = outside.grid
    inside = (coarse_inside & np.isnan(distance) | (distance < 0)) & ~outside.reached
    to_points, parted = outside.distance, np.zeros_like(inside)
    folds = None if options.genus == "free" else folded(cloud, outside, inside)
    del outside, coarse_inside, core  # most memory is needed next
    crossed_links = np.zeros((3, 0, 0, 0), dtype=bool)
    if folds is not None:
        crossed_links = _walls(cloud.select(~folds), grid)
        continued = _continued(cloud, grid, to_points)
        parted = contact_layer(inside, crossed_links, continued, to_points)
        inside &= ~parted
        if continued.any():
            crossed_links |= continued
        if folds.any():
            crossed_links |= _walls(cloud.select(folds), grid)
        del continued
    inside, bridges = joined(inside, cloud.points, grid, options, notes)
    if not inside.any():
        raise ReconstructionError(f"{len(cloud.points)} points enclose nothing")
    body, cuts = with_topology(inside, crossed_links, to_points, options, notes)
    del to_points, crossed_links
    mesh, is_invented, in_hole = _surface(body, inside, parted, distance, coarse, grid)
    invented = _invented(mesh, is_invented)
    mesh = _fair(mesh, in_hole, cloud)
    final = simplified(mesh, options.target_faces)
    step = Step(
        "surface",
        0.0,
        {
            "points": len(cloud.points),
            "cells": int(body.sum()),
            "cut_cells": len(cuts),
            "bridge_cells": len(bridges),
            "invented": invented,
            "faces_grid": len(mesh.faces),
            "faces": len(final.faces),
            "euler": final.euler_characteristic,
        },
        tuple(notes),
    )
    base = points_on(coarse.surface, coarse.base, cell)
    return final, SurfaceMarks(grid.centres(cuts), grid.centres(bridges), base), step


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


def _surface(
    body: Mask, inside: Mask, parted: Mask, distance: Voxels, coarse: Capped, grid: Grid
) -> tuple[TriangleMesh, Mask, Mask]:
    """The boundary surface of the voxels of the body, with vertices at the zeros of the signed distance.

    A vertex lies on a grid line between a voxel of the body and one outside. Where the signed distance
    changes its sign as the body does, the vertex is at the linearly interpolated zero. Elsewhere it is at the
    crossing of the coarse surface, if there is one, else in the middle, and is smoothed afterwards.

    body, inside: the body after and before region growing.
    parted: the voxels removed by `contact_layer`.
    distance: signed distance to the points; in voxels, NaN far from the points.
    Returns mesh, invented, in_hole: the surface, and two masks (n,): of the vertices that no points support,
        and of those of them that close a hole of the scan, not a cut or a bridge. Vertices beside removed
        contact voxels do not count, because there are points near them.
    """
    placed, invented, unseen, in_hole = [], [], [], []
    inside, parted, distance = inside.ravel(), parted.ravel(), distance.ravel()
    for axis, here in enumerate(crossed(body)):
        low = np.ravel_multi_index(tuple(here.T), body.shape)
        high = low + int(np.prod(body.shape[axis + 1 :]))
        at_low, at_high = distance[low], distance[high]
        changes = inside[low] != inside[high]
        believed = (
            changes & ((at_low < 0) == inside[low]) & ((at_high < 0) == inside[high])
        )
        believed &= np.isfinite(at_low) & np.isfinite(at_high)
        share = np.divide(
            at_low, at_low - at_high, out=np.full(len(here), 0.5), where=believed
        )
        crossing = crossings(coarse.surface, grid, axis).ravel()[low]
        share = np.where(
            believed, share, np.where(changes & np.isfinite(crossing), crossing, 0.5)
        )
        placed.append(Crossings(here, np.clip(share, LEAST_SHARE, 1 - LEAST_SHARE)))
        invented.append(~believed)
        unseen.append(~believed & ~parted[low] & ~parted[high])
        in_hole.append(unseen[axis] & changes)
    vertices, faces = marched(body, placed)
    moved = smoothed(vertices, faces, np.flatnonzero(np.concatenate(invented)), SMOOTHING)
    # The vertices after those on grid lines, inside cubes of the grid, are few.
    rest = (0, len(vertices) - sum(map(len, unseen)))
    counted, holes = (np.pad(np.concatenate(each), rest) for each in (unseen, in_hole))
    return TriangleMesh(grid.centres(moved), faces), counted, holes


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
    return float(np.linalg.norm(share @ vectors) / np.sqrt(vectors**2 @ np.ones(3)).sum())
