"""Oriented points → the body that they enclose, on a grid, and its surface."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pcretrieve.adapters import open3d
from pcretrieve.errors import ReconstructionError
from pcretrieve.options import SurfaceOptions
from pcretrieve.scan.outside import Grid, flood
from pcretrieve.scan.sampling import noise, spacing
from pcretrieve.surface.contacts import contacts, walls
from pcretrieve.surface.field import LEAST_WEIGHT, distance_field, folded, hidden_below, normals_of
from pcretrieve.surface.filled import filled
from pcretrieve.surface.handles import with_topology
from pcretrieve.surface.marching import Crossings, crossed, marched
from pcretrieve.surface.pieces import joined
from pcretrieve.surface.repair import largest_component
from pcretrieve.surface.simplify import simplified
from pcretrieve.surface.smooth import smoothed
from pcretrieve.surface.topology import compact, defects
from pcretrieve.types import FloatArray, PointCloud, Step, TriangleMesh

__all__ = ["SurfaceMarks", "body_surfaces"]

Mask = NDArray[np.bool_]
Voxels = NDArray[np.float32]

# Share of the body that the flood may claim before it has leaked, and how much wider gaps are shut then.
MOST_WET = 0.02
WIDER = (1.4, 2.0)

# Side of the cube of the coarse surface, relative to the longest side of the bounding box: room for the lid
# of a hole at the box's own border.
FILL_SCALE = 1.5

# Rounds of smoothing where the surface was invented: caps of holes, cuts and bridges.
SMOOTHING = 8

# Share of a surface that may be invented. Up to .18 the area was within a per cent, from .33 on it was wrong.
MOST_INVENTED = 0.3

# How far the invented part may lie on one side, by `_one_sidedness`: .04 for the dragon, a quarter of whose
# surface is invented in many places; .23 to .34 for halves of bodies.
MOST_ONE_SIDED = 0.15

# Cells are this many times as large as the noise of the points, within limits relative to the diagonal: small
# ones part fingers if points are exact, and make them ragged if they are not. mAP of TOSCA, 100 000 points,
# cells of .0045 and .0033: with noise of .0005 .842 and .867; with noise of .001, averaged in voxels of .003
# and .0025, .813 and .775.
NOISES = 6.5
FINEST = 0.0033
COARSEST = 0.0045

# Cells of the first surface, the second, the third, and so on in turn; relative to those asked for. Small
# ones part fingers and take gaps of the sampling for holes, large ones the reverse: none is right everywhere.
CELLS = (1.0, 4 / 3, 3 / 4)

# How far the cells of each further surface are shifted against those of the one before, modulo a cell: the
# multiples fill a cell evenly (Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018).
SHIFT = np.array([0.8191725134, 0.6710436067, 0.5497004779])

# A crossing is kept this far from the centres of its cells, so that no triangle loses its area.
MARGIN = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceMarks:
    """Where a surface is not what the points say.

    Attributes
    ----------
    cuts : (k, 3) float64
        Cells that were left out so that the body has the topology asked for; unit of the file.
    bridges : (j, 3) float64
        Cells that were added to join a piece to the body; unit of the file.
    """

    cuts: FloatArray
    bridges: FloatArray


def body_surfaces(cloud: PointCloud, options: SurfaceOptions) -> Iterator[tuple[TriangleMesh, SurfaceMarks]]:
    """Surfaces of the body that oriented points enclose: closed, connected, manifold, pointing outwards.

    Near the points, a cell is inside where the distance to the sphere that fits them is negative; away
    from them, in holes of the scan, where a coarse Poisson surface says so. The outside that a flood reaches
    is never inside. Unless the genus is ``free``, skins that touch are parted (see `contacts`), and the body
    is grown again inside those cells with the topology asked for (see `growth`): limbs that touch are cut
    apart, first of all along points that lie between them. Pieces that holes have cut off are joined to the
    body.

    Each of the surfaces is made on cells of another size, shifted against those of the others: they differ
    where the points leave a choice, in contacts and thin parts.

    Parameters
    ----------
    cloud : PointCloud
        With normals.
    options : SurfaceOptions

    Yields
    ------
    mesh : TriangleMesh
    marks : SurfaceMarks

    Raises
    ------
    ReconstructionError
        If the points do not surround a body, or hold two.
    """
    started = time.perf_counter()
    least = spacing(cloud.points)
    size = _cell(cloud, options)
    coarse = _coarse_surface(cloud, options)
    for number in range(options.reconstructions):
        cell = max(CELLS[number % len(CELLS)] * size, least)
        mesh, marks, step = _body_surface(cloud, coarse, cell, number * SHIFT % 1, options)
        step = replace(step, seconds=time.perf_counter() - started)
        yield TriangleMesh(mesh.vertices, mesh.faces, (*cloud.provenance, step)), marks
        started = time.perf_counter()


def _body_surface(
    cloud: PointCloud, coarse: TriangleMesh, cell: float, shift: FloatArray, options: SurfaceOptions
) -> tuple[TriangleMesh, SurfaceMarks, Step]:
    notes: list[str] = []
    deepest = hidden_below(cloud.diagonal, cell) + 1  # asked for between cells
    for gap in (options.gap, *(options.gap * wider for wider in WIDER)):
        outside = flood(cloud.points, cell=cell, gap=gap * cloud.diagonal, shift=shift, deepest=deepest)
        coarse_inside, coarse_crossings = filled(coarse, outside.grid)
        distance, weight = distance_field(cloud, outside)
        known = weight > LEAST_WEIGHT
        # Judged away from the points, where the coarse surface may lie a cell off.
        core = coarse_inside & ~known
        if (outside.wet & core).sum() <= MOST_WET * core.sum():
            break
    else:
        outside = replace(outside, wet=np.zeros_like(outside.wet), depth=np.zeros_like(outside.depth))
        distance, weight = distance_field(cloud, outside)
        known = weight > LEAST_WEIGHT
        notes.append("the flood of the outside leaked into the body and was not used")
    grid = outside.grid
    inside = np.where(known, distance < 0, coarse_inside) & ~outside.wet
    parted, skins = np.zeros_like(inside), np.zeros((3, *grid.shape), dtype=bool)
    if options.genus != "free":
        skins = _walls(cloud, grid)
        folds = folded(cloud, outside, inside)
        open_skins = _walls(cloud.select(~folds), grid) if folds.any() else skins
        parted = contacts(inside, open_skins, outside.distance)
        inside &= ~parted
    inside, bridges = joined(inside, cloud.points, grid, options, notes)
    if not inside.any():
        raise ReconstructionError(f"{len(cloud.points)} points enclose nothing")
    body, cuts = with_topology(inside, skins, outside, options, notes)
    known_distance = np.where(known, distance, np.nan)
    mesh, is_invented = _surface(body, inside, parted, known_distance, coarse_crossings, grid)
    invented = float(is_invented.mean())
    one_sided = _one_sidedness(mesh, is_invented) > MOST_ONE_SIDED
    if invented > MOST_INVENTED or one_sided:
        raise ReconstructionError(
            f"the points must surround a body, {invented:.0%} of its surface had to be invented"
            f"{', on one side' if one_sided else ''}: "
            "scan the sides that are missing, or merge this view with others"
        )
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
    marks = SurfaceMarks(_centres(cuts, grid), _centres(bridges, grid))
    return final, marks, step


def _cell(cloud: PointCloud, options: SurfaceOptions) -> float:
    """Edge of the first surface's cells; unit of the file."""
    if options.cell != "auto":
        return options.cell * cloud.diagonal
    return float(np.clip(NOISES * noise(cloud.points), FINEST * cloud.diagonal, COARSEST * cloud.diagonal))


def _walls(cloud: PointCloud, grid: Grid) -> Mask:
    return walls(grid.coordinates(cloud.points), normals_of(cloud), grid.shape)


def _coarse_surface(cloud: PointCloud, options: SurfaceOptions) -> TriangleMesh:
    """Poisson's surface, for what lies away from the points."""
    vertices, faces, _ = open3d.poisson(
        cloud.points, normals_of(cloud), depth=options.fill_depth, scale=FILL_SCALE
    )
    if not len(faces):
        raise ReconstructionError(f"Poisson reconstruction of {len(cloud.points)} points gave no surface")
    surface = compact(vertices, faces)
    largest, _ = largest_component(surface, 1.0)
    if n_open := defects(largest).boundary_edges:
        raise ReconstructionError(
            f"the points must surround a body, their surface has {n_open} boundary edges: "
            "scan the sides that are missing, or merge this view with others"
        )
    return surface


def _surface(
    body: Mask, inside: Mask, parted: Mask, distance: Voxels, coarse_crossings: Voxels, grid: Grid
) -> tuple[TriangleMesh, Mask]:
    """The body's surface where the distance to the points is zero, and (n,) which vertices are invented.

    Invented are caps of holes, cuts and bridges: they are smoothed, and the rest is left where it is. So are
    skins that were parted, but points lie there: they do not count.
    """
    crossings, invented, unseen = [], [], []
    for axis, here in enumerate(crossed(body)):
        low = tuple(here.T)
        high = tuple((here + np.eye(3, dtype=np.intp)[axis]).T)
        at_low, at_high = distance[low], distance[high]
        changes = inside[low] != inside[high]
        believed = changes & ((at_low < 0) == inside[low]) & ((at_high < 0) == inside[high])
        believed &= np.isfinite(at_low) & np.isfinite(at_high)
        share = np.divide(at_low, at_low - at_high, out=np.full(len(here), 0.5), where=believed)
        coarse = coarse_crossings[axis][low]
        share = np.where(believed, share, np.where(changes & np.isfinite(coarse), coarse, 0.5))
        crossings.append(Crossings(here, np.clip(share, MARGIN, 1 - MARGIN)))
        invented.append(~believed)
        unseen.append(~believed & ~parted[low] & ~parted[high])
    vertices, faces = marched(body, crossings)
    moved = smoothed(vertices, faces, np.flatnonzero(np.concatenate(invented)), SMOOTHING)
    counted = np.concatenate(unseen)
    # The few vertices after those on lines lie inside cells.
    counted = np.pad(counted, (0, len(vertices) - len(counted)))
    return TriangleMesh(moved * grid.cell + grid.origin, faces), counted


def _one_sidedness(mesh: TriangleMesh, invented: Mask) -> float:
    """The sum of the area vectors of a part of a closed surface, relative to the whole area.

    What is left of the surface has the opposite sum: 0 where it looks to all sides alike, 1/2 where it is
    one side of a sheet.
    """
    share = invented[mesh.faces].mean(axis=1)  # (m,)
    return float(np.linalg.norm(share @ mesh.area_vectors) / mesh.area)


def _centres(cells: NDArray[np.intp], grid: Grid) -> FloatArray:
    return np.asarray(cells * grid.cell + grid.origin, dtype=np.float64)
