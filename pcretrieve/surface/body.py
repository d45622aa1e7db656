"""Oriented points → the body that they enclose, on a grid, and its surface."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pcretrieve.adapters import open3d
from pcretrieve.errors import ReconstructionError
from pcretrieve.options import SurfaceOptions
from pcretrieve.scan.outside import FARTHEST, Grid, Outside, distances, flood, spacing
from pcretrieve.surface.growth import grown
from pcretrieve.surface.marching import crossed, marched
from pcretrieve.surface.repair import largest_component
from pcretrieve.surface.simplify import simplified
from pcretrieve.surface.smooth import smoothed
from pcretrieve.surface.topology import compact, defects
from pcretrieve.types import FloatArray, PointCloud, Step, TriangleMesh

__all__ = ["SurfaceMarks", "body_surface"]

Mask = NDArray[np.bool_]
Voxels = NDArray[np.float32]

# Each point tells the distance to its tangent plane this far round itself, weighted by a Gaussian; cells.
REACH = 3.0
SPREAD = 1.5

# Least sum of weights that a distance is believed at: about that of one point at the end of its reach.
LEAST_WEIGHT = 0.15

# How much deeper than its distance to the nearest point a cell may count; cells. Little, so that the way
# through a contact, between the points of two skins, is narrower than the way through a thin limb.
SKIN_DEPTH = 0.3

# A point is a disk of this radius that growth does not pass through while there is another way; cells.
DISK = 2.0

# Disks stand across an axis only where their normal leans this far towards it.
LEAST_LEAN = 0.3

# A point without a sensor is part of the surface only where the outside comes this near; relative to the
# diagonal, and to cells where those are coarse. Deeper ones lie in contacts and closed mouths, where no side
# can be told from the other.
HIDDEN = 0.02
HIDDEN_CELLS = 4.5

# Such points make a slit where they are at least this many cells, and where this share of the cells round
# them is outside. A contact of limbs is open all along its rim (.15 to .49 in TOSCA), a closed mouth only at
# the lips (.02 to .13): it is left out of the surface.
LEAST_SLIT = 100
LEAST_OPEN = 0.135

# Share of the body that the flood may claim before it has leaked, and how much wider gaps are shut then.
MOST_WET = 0.02
WIDER = (1.4, 2.0)

# Pieces that hold at least this share of the points belong to the body, and are joined to it.
LEAST_PIECE = 0.002

# Side of the cube of the coarse surface, relative to the longest side of the bounding box: room for the lid
# of a hole at the box's own border.
FILL_SCALE = 1.5

# A cut this thick beside the body's greatest depth went through a true handle.
HANDLE = 0.6

# Rounds of smoothing where the surface was invented: caps of holes, cuts and bridges.
SMOOTHING = 8

# Share of a surface that may be invented. Up to .18 the area was within a per cent, from .33 on it was wrong.
MOST_INVENTED = 0.3

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


def body_surface(cloud: PointCloud, options: SurfaceOptions) -> tuple[TriangleMesh, SurfaceMarks]:
    """The surface of the body that oriented points enclose: closed, connected, manifold, pointing outwards.

    Near the points, a cell is inside where the weighted distance to their tangent planes is negative; away
    from them, in holes of the scan, where a coarse Poisson surface says so. The outside that a flood reaches
    is never inside. The body is then grown again inside those cells with the topology asked for (see
    `growth`): limbs that touch are cut apart, first of all along points that lie between them. Pieces that
    holes have cut off are joined to the body.

    Parameters
    ----------
    cloud : PointCloud
        With normals.
    options : SurfaceOptions

    Returns
    -------
    mesh : TriangleMesh
    marks : SurfaceMarks

    Raises
    ------
    ReconstructionError
        If the points do not surround a body, or hold two.
    """
    started = time.perf_counter()
    notes: list[str] = []
    cell = max(options.cell * cloud.diagonal, spacing(cloud.points))
    coarse = _coarse_surface(cloud, options)
    for gap in (options.gap, *(options.gap * wider for wider in WIDER)):
        outside = flood(cloud.points, cell=cell, gap=gap * cloud.diagonal)
        filled, coarse_crossings = _inside_surface(coarse, outside.grid)
        distance, weight = _distance_field(cloud, outside)
        known = weight > LEAST_WEIGHT
        # Judged away from the points, where the coarse surface may lie a cell off.
        core = filled & ~known
        if (outside.wet & core).sum() <= MOST_WET * core.sum():
            break
    else:
        outside = replace(outside, wet=np.zeros_like(outside.wet), depth=np.zeros_like(outside.depth))
        distance, weight = _distance_field(cloud, outside)
        known = weight > LEAST_WEIGHT
        notes.append("the flood of the outside leaked into the body and was not used")
    grid = outside.grid
    inside = np.where(known, distance < 0, filled) & ~outside.wet
    inside &= ~_slits(cloud, outside, inside)
    inside, bridges = _joined(inside, cloud.points, grid, options, notes)
    if not inside.any():
        raise ReconstructionError(f"{len(cloud.points)} points enclose nothing")
    body, cuts = _with_topology(inside, cloud, outside, options, notes)
    mesh, invented = _surface(body, inside, np.where(known, distance, np.nan), coarse_crossings, grid)
    if invented > MOST_INVENTED:
        raise ReconstructionError(
            f"the points must surround a body, {invented:.0%} of its surface had to be invented: "
            "scan the sides that are missing, or merge this view with others"
        )
    final = simplified(mesh, options.target_faces)
    step = Step(
        "surface",
        time.perf_counter() - started,
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
    return TriangleMesh(final.vertices, final.faces, (*cloud.provenance, step)), marks


def _normals_of(cloud: PointCloud) -> FloatArray:
    if cloud.normals is None:
        raise ReconstructionError("reconstruction needs points with normals, these have none")
    return cloud.normals


def _coarse_surface(cloud: PointCloud, options: SurfaceOptions) -> TriangleMesh:
    """Poisson's surface, for what lies away from the points."""
    vertices, faces, _ = open3d.poisson(
        cloud.points, _normals_of(cloud), depth=options.fill_depth, scale=FILL_SCALE
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


def _inside_surface(mesh: TriangleMesh, grid: Grid) -> tuple[Mask, Voxels]:
    """Cells inside closed surfaces, by the parity of crossings along the last axis, and where lines cross.

    The crossings, (3, a, b, c), lie between a cell's centre and the next along each axis; NaN where none is.
    """
    scene = open3d.RayScene(mesh.vertices - grid.origin, mesh.faces)
    crossings = np.full((3, *grid.shape), np.nan, dtype=np.float32)
    inside = np.zeros(grid.shape, dtype=bool)
    for axis in range(3):
        others = [k for k in range(3) if k != axis]
        lines = np.indices([grid.shape[k] for k in others]).reshape(2, -1).T  # (l, 2)
        origins = np.zeros((len(lines), 3))
        # Not through the vertices, which may lie on the grid.
        origins[:, others] = (lines + np.array([1e-4, 1.7e-4])) * grid.cell
        origins[:, axis] = -grid.cell
        line, distance = scene.crossings(origins, np.eye(3)[axis])
        at = distance / grid.cell - 1
        place = np.floor(at).astype(np.intp)
        on_grid = (place >= 0) & (place < grid.shape[axis] - 1)
        index: list[NDArray[np.intp]] = [place[on_grid]] * 3
        for k, other in enumerate(others):
            index[other] = lines[line[on_grid], k]
        crossings[(axis, index[0], index[1], index[2])] = (at - place)[on_grid]
        if axis == 2:
            turns = np.zeros(grid.shape, dtype=np.int32)
            np.add.at(turns, (index[0], index[1], index[2] + 1), 1)
            inside = turns.cumsum(axis=2) % 2 == 1
    for side in (0, -1):
        inside[side] = inside[:, side] = inside[:, :, side] = False
    return inside, crossings


def _distance_field(cloud: PointCloud, outside: Outside) -> tuple[Voxels, Voxels]:
    """Weighted mean distance to the tangent planes of near points, cells, and the sum of its weights."""
    points, normals = cloud.points, _normals_of(cloud)
    if cloud.viewpoints is None:
        shown = ~_hidden(cloud, outside)
        points, normals = points[shown], normals[shown]
    total, weight = _splatted(outside.grid.coordinates(points), normals, outside.grid.shape)
    return (total / np.maximum(weight, LEAST_WEIGHT / 2)).astype(np.float32), weight


def _hidden(cloud: PointCloud, outside: Outside) -> Mask:
    """(n,) points that the outside does not come near to."""
    depth = outside.depth_at(cloud.points)  # (n,) cells
    return np.asarray(depth > max(HIDDEN_CELLS, HIDDEN * cloud.diagonal / outside.grid.cell))


@njit(cache=True)
def _splatted(at: FloatArray, normals: FloatArray, shape: tuple[int, int, int]) -> tuple[Voxels, Voxels]:
    total = np.zeros(shape, dtype=np.float32)
    weight = np.zeros(shape, dtype=np.float32)
    for i in range(len(at)):
        x, y, z = at[i]
        for u in range(max(0, int(np.ceil(x - REACH))), min(shape[0], int(x + REACH) + 1)):
            for v in range(max(0, int(np.ceil(y - REACH))), min(shape[1], int(y + REACH) + 1)):
                for w in range(max(0, int(np.ceil(z - REACH))), min(shape[2], int(z + REACH) + 1)):
                    square = (u - x) ** 2 + (v - y) ** 2 + (w - z) ** 2
                    if square <= REACH * REACH:
                        share = np.exp(-square / (2 * SPREAD * SPREAD))
                        weight[u, v, w] += share
                        plane = normals[i, 0] * (u - x) + normals[i, 1] * (v - y) + normals[i, 2] * (w - z)
                        total[u, v, w] += share * plane
    return total, weight


def _slits(cloud: PointCloud, outside: Outside, inside: Mask) -> Mask:
    """Cells at points deep inside: two skins that touch there, or one that is folded in."""
    from scipy import ndimage

    grid = outside.grid
    if cloud.viewpoints is not None:
        return np.zeros(grid.shape, dtype=bool)
    slit = np.zeros(grid.shape, dtype=bool)
    slit[grid.index(cloud.points[_hidden(cloud, outside)])] = True
    slit = ndimage.binary_dilation(slit)
    pieces, n = ndimage.label(slit, np.ones((3, 3, 3)))
    kept = np.zeros(n + 1, dtype=bool)
    for piece, box in enumerate(ndimage.find_objects(pieces), start=1):
        wider = tuple(slice(max(0, side.start - 1), side.stop + 1) for side in box)
        cells = pieces[wider] == piece
        rim = ndimage.binary_dilation(cells) & ~cells
        kept[piece] = cells.sum() >= LEAST_SLIT and (rim & ~inside[wider]).sum() >= LEAST_OPEN * rim.sum()
    return np.asarray(kept[pieces])


def _joined(
    inside: Mask, points: FloatArray, grid: Grid, options: SurfaceOptions, notes: list[str]
) -> tuple[Mask, NDArray[np.intp]]:
    """The largest piece with those that belong to it, without cavities; and (j, 3) cells that join them."""
    from scipy import ndimage

    nowhere = np.zeros((0, 3), dtype=np.intp)
    pieces, n = ndimage.label(inside)
    if n == 0:
        return inside, nowhere
    # Points lie on the surface of their piece, in it or just outside.
    at = np.array(grid.index(points))  # (3, n)
    round_it = np.indices((3, 3, 3)).reshape(3, 27, 1) - 1
    x, y, z = at[:, None] + round_it  # (27, n) each
    near = pieces[x, y, z].max(axis=0)  # (n,)
    support = np.bincount(near, minlength=n + 1) / len(points)
    sizes = np.bincount(pieces.ravel())
    sizes[0] = 0
    body = pieces == sizes.argmax()
    support[0] = support[sizes.argmax()] = 0
    bridges = []
    for piece in np.argsort(-support)[: int((support > LEAST_PIECE).sum())]:
        depth, nearest = ndimage.distance_transform_edt(~body, return_indices=True)
        cells = np.argwhere(pieces == piece)
        start = cells[depth[tuple(cells.T)].argmin()]
        gap = depth[tuple(start)] * grid.cell
        if gap > options.bridge * np.linalg.norm(np.ptp(points, axis=0)):
            if support[piece] > options.max_discarded:
                raise ReconstructionError(
                    f"the scan holds two bodies or more: a second piece has {support[piece]:.0%} of the "
                    "points; cut them apart, or raise surface.max_discarded"
                )
            notes.append(f"dropped a piece with {support[piece]:.1%} of the points, {gap:.3g} away")
            continue
        end = nearest[:, start[0], start[1], start[2]].astype(np.intp)
        tube = _tube(start, end, radius=min(3.0, max(1.5, _thickness(pieces == piece))))
        bridges.append(tube[~body[tuple(tube.T)] & (pieces[tuple(tube.T)] != piece)])
        body |= pieces == piece
        body[tuple(tube.T)] = True
        notes.append(f"joined a piece with {support[piece]:.1%} of the points across a gap of {gap:.3g}")
    hollow, _ = ndimage.label(~body, np.ones((3, 3, 3)))
    return hollow != hollow[0, 0, 0], np.concatenate([nowhere, *bridges])


def _thickness(piece: Mask) -> float:
    """Largest distance from the outside; cells."""
    from scipy.ndimage import distance_transform_edt

    return float(distance_transform_edt(piece).max())


def _tube(start: NDArray[np.intp], end: NDArray[np.intp], *, radius: float) -> NDArray[np.intp]:
    """(k, 3) cells nearer than `radius` to the line between two cells."""
    low = np.minimum(start, end) - int(radius) - 1
    box = np.indices(np.abs(end - start) + 2 * int(radius) + 3).reshape(3, -1).T + low  # (b, 3)
    along = (end - start).astype(np.float64)
    share = np.clip((box - start) @ along / max(along @ along, 1e-9), 0, 1)  # (b,)
    apart = np.linalg.norm(box - start - share[:, None] * along, axis=1)
    return np.asarray(box[apart <= radius], dtype=np.intp)


def _with_topology(
    inside: Mask, cloud: PointCloud, outside: Outside, options: SurfaceOptions, notes: list[str]
) -> tuple[Mask, NDArray[np.intp]]:
    """The cells with the genus asked for, and those that had to go, (k, 3)."""
    if options.genus == "free":
        return inside, np.zeros((0, 3), dtype=np.intp)
    depth = distances(~inside, np.inf)
    # Where limbs touch, points lie between them: the way through is narrow there.
    to_points = np.where(outside.distance < FARTHEST, outside.distance + SKIN_DEPTH, np.inf)
    priority = np.minimum(depth, to_points).astype(np.float32)
    walls = _walls(outside.grid.coordinates(cloud.points), _normals_of(cloud), outside.grid.shape)
    body = grown(inside, priority, walls)
    if options.genus not in ("sphere", 0):
        body = _with_handles(inside, body, depth, options.genus, notes)
    return body, np.argwhere(inside & ~body)


def _with_handles(inside: Mask, body: Mask, depth: Voxels, genus: str | int, notes: list[str]) -> Mask:
    """The body with its thickest cuts undone, each of which closes one handle.

    A contact is thin beside the limbs that meet in it, a true handle is not: ``auto`` undoes the cuts that
    reach `HANDLE` of the body's own greatest depth. A number undoes as many, thickest first.
    """
    from scipy import ndimage

    cuts, _ = ndimage.label(inside & ~body, np.ones((3, 3, 3)))
    boxes = ndimage.find_objects(cuts)
    thickness = ndimage.maximum(depth, cuts, np.arange(1, len(boxes) + 1))
    wanted = len(boxes) if genus == "auto" else int(genus)
    made = 0
    for cut in np.argsort(-np.asarray(thickness)):
        if made == wanted or (genus == "auto" and thickness[cut] < HANDLE * depth.max()):
            break
        box = tuple(slice(side.start - 2, side.stop + 2) for side in boxes[cut])
        closed = body[box] | (cuts[box] == cut + 1)
        change = _euler(closed) - _euler(body[box])
        if change == -2:  # one handle, and nothing else
            body[box] = closed
            made += 1
    if genus == "auto" and made:
        notes.append(f"kept {made} handles as thick as the body round them; genus = 'sphere' would cut them")
    elif genus != "auto" and made < int(genus):
        notes.append(f"only {made} of {genus} handles were found")
    return body


def _euler(body: Mask) -> int:
    """Euler characteristic of the surface of some cells, as `marched` makes it."""
    padded = np.pad(body, 1)
    if not padded.any():
        return 0
    vertices, faces = marched(padded, np.full((3, *padded.shape), 0.5))
    return TriangleMesh(vertices, faces).euler_characteristic


@njit(cache=True)
def _walls(at: FloatArray, normals: FloatArray, shape: tuple[int, int, int]) -> Mask:
    """Ways from a cell to the next along each axis that pass through a disk round a point."""
    walls = np.zeros((3, shape[0], shape[1], shape[2]), dtype=np.bool_)
    place = np.zeros(3, dtype=np.int64)
    for i in range(len(at)):
        for axis in range(3):
            lean = normals[i, axis]
            if abs(lean) < LEAST_LEAN:
                continue
            first, second = (axis + 1) % 3, (axis + 2) % 3
            for a in range(int(np.ceil(at[i, first] - DISK)), int(np.floor(at[i, first] + DISK)) + 1):
                for b in range(int(np.ceil(at[i, second] - DISK)), int(np.floor(at[i, second] + DISK)) + 1):
                    da, db = a - at[i, first], b - at[i, second]
                    along = -(normals[i, first] * da + normals[i, second] * db) / lean
                    if da * da + db * db + along * along > DISK * DISK:
                        continue
                    place[axis], place[first], place[second] = int(np.floor(at[i, axis] + along)), a, b
                    if (
                        (place >= 0).all()
                        and place[0] < shape[0]
                        and place[1] < shape[1]
                        and place[2] < shape[2]
                    ):
                        walls[axis, place[0], place[1], place[2]] = True
    return walls


def _surface(
    body: Mask, inside: Mask, distance: Voxels, coarse_crossings: Voxels, grid: Grid
) -> tuple[TriangleMesh, float]:
    """The body's surface where the distance to the points is zero, and the share of it that is invented.

    Invented are caps of holes, cuts and bridges: they are smoothed, and the rest is left where it is.
    """
    crossings = np.full((3, *grid.shape), 0.5)
    invented = []
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
        crossings[axis][low] = np.clip(share, MARGIN, 1 - MARGIN)
        invented.append(~believed)
    vertices, faces = marched(body, crossings)
    loose = np.concatenate([*invented, np.zeros(len(vertices) - sum(map(len, invented)), dtype=bool)])
    moved = smoothed(vertices, faces, np.flatnonzero(loose), SMOOTHING)
    return TriangleMesh(moved * grid.cell + grid.origin, faces), float(loose.mean())


def _centres(cells: NDArray[np.intp], grid: Grid) -> FloatArray:
    return np.asarray(cells * grid.cell + grid.origin, dtype=np.float64)
