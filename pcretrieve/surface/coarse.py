"""Oriented points → the indicator function of their body on a coarse grid, by Fourier transforms."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pcretrieve.arrays import bounds
from pcretrieve.options import SurfaceOptions
from pcretrieve.points.density import local_spacings
from pcretrieve.points.neighbors import PLANE_NEIGHBORS, Neighborhoods, neighborhoods
from pcretrieve.points.voxels import Voxels, sampled
from pcretrieve.surface.caps import (
    NO_CAP,
    Capped,
    capped,
    limbs_continued,
    outwards_at_rims,
)
from pcretrieve.surface.field import normals_of
from pcretrieve.surface.marching import level_set
from pcretrieve.surface.poisson import not_closed, poisson
from pcretrieve.values import FloatArray, Grid, Mask, PointCloud, TriangleMesh
from pcretrieve.values.compiled import compiled, inlined, inner
from pcretrieve.values.repair import largest_component
from pcretrieve.values.topology import components, defects

# Standard deviation of the Gaussian filter of the indicator function; in voxels.
FILTER = 0.6


def indicator(
    points: FloatArray, normals: FloatArray, spacings: FloatArray, grid: Grid
) -> Voxels:
    """The indicator function of a body, smoothed, from oriented points of its surface [1]_.

    The gradient of the indicator function χ is concentrated on the surface, where it is −n. It is known at
    the points, each of which stands for a small piece of the surface, and χ is the solution of the Poisson
    equation whose right side is the divergence of this field. On a periodic grid the Fourier transform of χ
    is i k · V / k², with the transform V of the field n and the wave vector k. Where a part of the surface
    was not seen, χ is the solid angle of the other parts divided by 4π (generalized winding number [2]_):
    in a flat hole it is 1/2.

    spacings: (n,) float64, the square root of the area of surface for each point. A point stands for an area
        of at most one face of a voxel.
    Returns (a, b, c) float32: about 1 inside and 0 outside. Exactly 0 at the corners of the grid.

    References
    ----------
    .. [1] M. Kazhdan, "Reconstruction of solid models from oriented point sets", Symposium on Geometry
       Processing 2005.
    .. [2] G. Barill, N. Dickson, R. Schmidt, D. Levin and A. Jacobson, "Fast winding numbers for soups and
       clouds", ACM Transactions on Graphics 37 (2018).
    """
    from scipy import fft

    # Of the area of the face of a voxel.
    shares = np.minimum(spacings / grid.cell, 1) ** 2
    field = _splatted(grid.coordinates(points), shares[:, None] * normals, grid.shape)
    n_x, n_y, n_z = grid.shape
    frequencies = np.ix_(fft.fftfreq(n_x), fft.fftfreq(n_y), fft.rfftfreq(n_z))
    x, y, z = (
        np.asarray(2 * np.pi * frequency, dtype=np.float32) for frequency in frequencies
    )
    squares = x**2 + y**2 + z**2
    squares[0, 0, 0] = 1  # the divergence is zero there
    divergence = (
        x * fft.rfftn(field[0]) + y * fft.rfftn(field[1]) + z * fft.rfftn(field[2])
    )
    smooth = np.exp(np.float32(-(FILTER**2) / 2) * squares) / squares
    values = fft.irfftn(np.complex64(1j) * smooth * divergence, grid.shape)
    return np.asarray(values - values[0, 0, 0], dtype=np.float32)


@compiled()
def _splatted(at: FloatArray, vectors: FloatArray, shape: tuple[int, int, int]) -> Voxels:
    """(3, a, b, c) sums of vectors at positions in voxels.

    The eight voxels around a position share its vector by trilinear weights: 1 − distance along each axis.
    """
    field = np.zeros((3, shape[0], shape[1], shape[2]), dtype=np.float32)
    for i in range(len(at)):
        x, y, z = int(at[i, 0]), int(at[i, 1]), int(at[i, 2])
        # The position relative to the voxel (x, y, z), from 0 to 1.
        u, v, w = at[i, 0] - x, at[i, 1] - y, at[i, 2] - z
        for a in range(2):
            for b in range(2):
                for c in range(2):
                    share = abs(1 - a - u) * abs(1 - b - v) * abs(1 - c - w)
                    for axis in range(3):
                        field[axis, x + a, y + b, z + c] += share * vectors[i, axis]
    return field


# --- inside a mesh ---------------------------------------------------------------------------------------
#
# Along each line of voxels we note where it crosses a face of the mesh. A voxel is inside if its line crosses
# the mesh an odd number of times before it.

# Offset of the lines from the centres of the voxels, at which vertices may lie; in voxels.
BESIDE = (1e-4, 1.7e-4)


def filled(mesh: TriangleMesh, grid: Grid) -> Mask:
    """(a, b, c) mask of the voxels whose centre is inside a mesh.

    A voxel is inside if the line to it along the last axis crosses the mesh an odd number of times (parity
    rule). The side of an edge on which a line passes is computed identically for both faces at the edge, so
    that the line crosses exactly one of them. Rays cast in single precision do not guarantee this.
    """
    odd, _ = _crossed(grid.coordinates(mesh.vertices), mesh.faces, grid.shape, 2)
    _accumulate(odd)
    for side in (0, -1):
        odd[side] = odd[:, side] = odd[:, :, side] = False
    return odd


def crossings(mesh: TriangleMesh, grid: Grid, axis: int) -> Voxels:
    """(a, b, c) where a mesh crosses the line from each centre to the next: in [0, 1), NaN if nowhere."""
    return _crossed(grid.coordinates(mesh.vertices), mesh.faces, grid.shape, axis)[1]


@compiled()
def _accumulate(odd: Mask) -> None:
    """Turn the changes of the parity along the last axis into the parity."""
    for x in range(odd.shape[0]):
        for y in range(odd.shape[1]):
            line, is_inside = odd[x, y], False
            for z in range(len(line)):
                is_inside ^= line[z]
                line[z] = is_inside


@compiled()
def _crossed(
    at: FloatArray, faces: NDArray[np.int32], shape: tuple[int, int, int], axis: int
) -> tuple[Mask, Voxels]:
    """The voxels after an odd number of crossings with their line along an axis, and `crossings`.

    The lines that may meet a face are those in the bounding box of its projection along the axis.
    """
    odd = np.zeros(shape, dtype=np.bool_)
    crossings = np.full(shape, np.float32(np.nan), dtype=np.float32)
    i, j = (1 if axis == 0 else 0), (1 if axis == 2 else 2)
    place = np.zeros(3, dtype=np.int64)
    for face in faces:
        first, last = _lines(at, face, i, shape[i], BESIDE[0])
        lowest, highest = _lines(at, face, j, shape[j], BESIDE[1])
        for u in range(first, last):
            for v in range(lowest, highest):
                along = _meeting(at, face, (i, j, axis), u + BESIDE[0], v + BESIDE[1])
                if np.isnan(along):
                    continue
                below = int(np.floor(along))
                if below >= shape[axis] - 1:
                    continue
                place[i], place[j] = u, v
                # A crossing before the first voxel changes the parity of all voxels of the line.
                place[axis] = max(0, below + 1)
                odd[place[0], place[1], place[2]] ^= True
                if below >= 0:
                    place[axis] = below
                    crossings[place[0], place[1], place[2]] = along - below
    return odd, crossings


@inner()
def _lines(
    at: FloatArray, face: NDArray[np.int32], axis: int, n: int, beside: float
) -> tuple[int, int]:
    """The first of n lines, `beside` the voxels of an axis, between the ends of a face; and the one after."""
    a, b, c = at[face[0], axis], at[face[1], axis], at[face[2], axis]
    first = max(0, int(np.ceil(min(a, b, c) - beside)))
    last = min(n - 1, int(np.floor(max(a, b, c) - beside)))
    return first, last + 1


@inlined()
def _meeting(
    at: FloatArray,
    face: NDArray[np.int32],
    axes: tuple[int, int, int],
    x: float,
    y: float,
) -> float:
    """Where a line meets a face, along the last of the axes; NaN if it does not.

    (x, y): the place of the line along the two other axes.
    """
    i, j, axis = axes
    p, q, r = face
    left = _left(at, p, q, i, j, x, y)
    if left != _left(at, q, r, i, j, x, y) or left != _left(at, r, p, i, j, x, y):
        return np.nan
    # The place a + s (b − a) + t (c − a) in the plane of the corners a, b and c.
    first_x, second_x = at[q, i] - at[p, i], at[r, i] - at[p, i]
    first_y, second_y = at[q, j] - at[p, j], at[r, j] - at[p, j]
    area = first_x * second_y - second_x * first_y
    if area == 0:
        return np.nan
    s = ((x - at[p, i]) * second_y - second_x * (y - at[p, j])) / area
    t = (first_x * (y - at[p, j]) - (x - at[p, i]) * first_y) / area
    along = (
        at[p, axis] + s * (at[q, axis] - at[p, axis]) + t * (at[r, axis] - at[p, axis])
    )
    return float(along)


@inner()
def _left(at: FloatArray, p: int, q: int, i: int, j: int, x: float, y: float) -> bool:
    """Whether (x, y) is left of the directed line from p to q in the projection along an axis."""
    # Evaluated from the lower to the higher vertex number, so that the two directions never agree.
    low, high = min(p, q), max(p, q)
    across, up = at[high, i] - at[low, i], at[high, j] - at[low, j]
    turn = across * (y - at[low, j]) - up * (x - at[low, i])
    # Symbolic perturbation: (x, y) moves by ε along the first axis, by ε² along the second.
    if turn == 0:
        turn = across if up == 0 else -up
    return bool((turn > 0) == (p < q))


# Smallest distance of the points from the border of the grid of the indicator function, relative to the
# longest side of their bounding box.
MARGIN = 0.15

# Level of the coarse surface, relative to the mean of the indicator function at the points. Below 1, the
# surface bulges out of holes, as convex bodies do. See docs/decisions.md, LEVEL.
LEVEL = 0.65

# Least share of a coarse surface in caps for a grid that is finer by this factor, or less: its voxels are at
# least so many spacings wide, which this share of the points do not exceed, because points farther apart
# leave gaps. See docs/decisions.md, rim of a cap.
MUCH_CAPPED = 0.02
FINER = 2
LEAST_SPACINGS = 1.6
DENSE = 0.9

# Side of the cube of the coarse Poisson surface, relative to the longest side of the bounding box. Larger
# than the default of 1.1, so that holes at the border of the bounding box can be closed outside it; and
# larger again, if the surface is not closed, as where a body stands.
FILL_SCALE = 1.5
BASE_SCALE = 2.0

# Least share of the faces in pieces beside the largest one, for ends of limbs to be looked for.
LEAST_PIECE = 0.005


def coarse_surface(
    cloud: PointCloud,
    options: SurfaceOptions,
    neighbors: Neighborhoods,
    *,
    spacing: float,
) -> tuple[Capped, PointCloud]:
    """Reconstruct a coarse surface, which decides far from the points.

    It is a level set of the indicator function of the body. If that is open, or there are sensors from which
    parts of the body were hidden, it is a screened Poisson surface instead. Either is closed anew in large
    holes: see `capped`. Its largest component is closed. Where holes are a large part of it, as on a
    turntable, the level set is made again on a finer grid, on which fingers and thin bodies have several
    voxels across.

    neighbors, spacing: those of all points.
    Returns Capped, PointCloud: the surface, and the points with those of `limbs_continued`.
    """
    # See docs/decisions.md, LEVEL, for scans with sensor positions.
    if cloud.viewpoints is not None:
        surface = _poisson_surface(cloud, options.fill_depth)
        return capped(surface, cloud, spacing=spacing), cloud
    n = 2**options.fill_depth
    spacings = local_spacings(neighbors)
    for finer in (1, FINER):
        level = _level_set(cloud, spacings, n, finer)
        if level and (components(level) > 0).mean() > LEAST_PIECE:
            known = limbs_continued(cloud, spacing)
            around = local_spacings(neighborhoods(known.points, PLANE_NEIGHBORS + 1))
            if again := _level_set(known, around, n, finer):
                level, cloud, spacings = again, known, around
        surface = level or _poisson_surface(cloud, options.fill_depth)
        found = capped(surface, cloud, spacing=spacing)
        areas = found.surface.face_areas
        if areas[found.cap != NO_CAP].sum() < MUCH_CAPPED * areas.sum():
            break
    turned = outwards_at_rims(found, cloud)
    has_turned = (normals_of(turned) != normals_of(cloud)).any()
    if has_turned and (again := _level_set(turned, spacings, n, finer)):
        return capped(again, turned, spacing=spacing), turned
    return found, cloud


def _level_set(
    cloud: PointCloud, spacings: FloatArray, n: int, finer: int
) -> TriangleMesh | None:
    """The level set of the indicator function on a grid, as by `_grid`; None if it is empty or open."""
    least = LEAST_SPACINGS * float(np.quantile(spacings, DENSE))
    grid = _grid(cloud.points, n, finer, least)
    values = indicator(cloud.points, normals_of(cloud), spacings, grid)
    at_points = float(sampled(values, grid.coordinates(cloud.points)).mean())
    level = np.float32(LEVEL * at_points)
    body = values > level
    is_open = any(
        np.take(body, side, axis).any() for axis in range(3) for side in (0, -1)
    )
    if is_open or not body.any():
        return None
    vertices, faces = level_set(values, level)
    return TriangleMesh(grid.centres(vertices), faces)


def _grid(points: FloatArray, n: int, finer: int, least: float) -> Grid:
    """A grid with n voxels, or a few more, on its longest side, whose Fourier transform is fast.

    The edge of its voxels is up to this many times as fine, but then not less than the least.
    """
    from scipy import fft

    low, high = bounds(points)
    longest = float((high - low).max())
    coarsest = (1 + 2 * MARGIN) * longest / n
    cell = float(np.clip(least, coarsest / finer, coarsest))
    smallest = Grid.around(points, cell, int(np.ceil(MARGIN * longest / cell)))
    a, b, c = (int(fft.next_fast_len(side, real=True)) for side in smallest.shape)
    return Grid(smallest.origin, cell, (a, b, c))


def _poisson_surface(cloud: PointCloud, depth: int) -> TriangleMesh:
    """The screened Poisson surface; if it is not closed, as where a body stands, that in a larger cube."""
    for scale in (FILL_SCALE, BASE_SCALE):
        surface = poisson(cloud.points, normals_of(cloud), depth=depth, scale=scale)
        largest, _ = largest_component(surface, 1.0)
        if not (n_open := defects(largest).boundary_edges):
            return surface
    raise not_closed(cloud, f"{n_open} boundary edges")
