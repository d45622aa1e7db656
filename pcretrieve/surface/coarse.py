"""Oriented points → a coarse closed surface, which closes the holes of a scan."""

from __future__ import annotations

import numpy as np

from pcretrieve.errors import ReconstructionError
from pcretrieve.options import SurfaceOptions
from pcretrieve.points.density import local_spacings
from pcretrieve.points.nearest import nearest
from pcretrieve.points.sampling import SPACING_NEIGHBORS, neighborhoods
from pcretrieve.points.voxels import Grid, sampled
from pcretrieve.surface import open3d
from pcretrieve.surface.caps import NO_CAP, Capped, capped
from pcretrieve.surface.field import normals_of
from pcretrieve.surface.indicator import indicator
from pcretrieve.surface.marching import Crossings, crossed, marched
from pcretrieve.surface.repair import largest_component
from pcretrieve.surface.topology import compact, defects
from pcretrieve.values import FloatArray, PointCloud, TriangleMesh

__all__ = ["coarse_surface"]

# Smallest distance of the points from the border of the grid of the indicator function, relative to the
# longest side of their bounding box.
MARGIN = 0.15

# Level of the coarse surface, relative to the mean of the indicator function at the points. Below 1, the
# surface bulges out of holes, as convex bodies do. See docs/decisions.md, LEVEL.
LEVEL = 0.65

# The level sets of the indicator function are close to each other at the points, and far apart in holes. A
# hole is large if a place outside, where the function exceeds this level, is farther than this distance,
# relative to the diagonal, from all points. See docs/decisions.md, WIDE.
FRINGE = 0.25
WIDE = 0.036

# Smallest distance of a vertex from the ends of its link, relative to the link, so that no triangle becomes
# degenerate.
LEAST_SHARE = 0.02

# Side of the cube of the coarse Poisson surface, relative to the longest side of the bounding box. Larger
# than the default of 1.1, so that holes at the border of the bounding box can be closed outside it; and
# larger again, if the surface is not closed, as where a body stands. See docs/decisions.md, BASE_SCALE.
FILL_SCALE = 1.5
BASE_SCALE = 2.0


def coarse_surface(cloud: PointCloud, options: SurfaceOptions, *, spacing: float) -> Capped:
    """Reconstruct a coarse surface, which decides far from the points.

    It is a level set of the indicator function of the body. If the points have large holes, or sensors from
    which parts of the body were hidden, it is a screened Poisson surface instead, which bulges out of large
    holes and is replaced by flat caps there.

    spacing: of the points; unit of the file.
    Returns Capped: the surface, of which the largest component is closed, and its caps; unit of the file.
    """
    # See docs/decisions.md, LEVEL, for scans with sensor positions.
    surface = _level_set(cloud, 2**options.fill_depth) if cloud.viewpoints is None else None
    if surface is None:
        return capped(_poisson_surface(cloud, options.fill_depth), cloud, spacing=spacing)
    return Capped(surface, np.full(len(surface.faces), NO_CAP))


def _level_set(cloud: PointCloud, n: int) -> TriangleMesh | None:
    """The level set of the indicator function on a grid; None if it is empty, open, or has large holes."""
    grid = _grid(cloud.points, n)
    spacings = local_spacings(neighborhoods(cloud.points, SPACING_NEIGHBORS + 1))
    values = indicator(cloud.points, normals_of(cloud), spacings, grid)
    at_points = float(sampled(values, grid.coordinates(cloud.points)).mean())
    level = np.float32(LEVEL * at_points)
    body = values > level
    is_open = any(np.take(body, side, axis).any() for axis in range(3) for side in (0, -1))
    if is_open or not body.any():
        return None
    fringe = np.argwhere((values > FRINGE * at_points) & (values < at_points)) * grid.cell + grid.origin
    if nearest(cloud.points, fringe, 1)[0].max(initial=0.0) > WIDE * cloud.diagonal:
        return None
    crossings = []
    for axis, low in enumerate(crossed(body)):
        at_low, at_high = values[tuple(low.T)], values[tuple((low + np.eye(3, dtype=np.intp)[axis]).T)]
        share = (level - at_low) / (at_high - at_low)
        crossings.append(Crossings(low, np.clip(share, LEAST_SHARE, 1 - LEAST_SHARE)))
    vertices, faces = marched(body, crossings)
    return TriangleMesh(vertices * grid.cell + grid.origin, faces)


def _grid(points: FloatArray, n: int) -> Grid:
    """A grid with n voxels, or a few more, on its longest side, whose Fourier transform is fast."""
    from scipy import fft

    longest = float(np.ptp(points, axis=0).max())
    cell = (1 + 2 * MARGIN) * longest / n
    smallest = Grid.around(points, cell, int(np.ceil(MARGIN * longest / cell)))
    a, b, c = (int(fft.next_fast_len(side, real=True)) for side in smallest.shape)
    return Grid(smallest.origin, cell, (a, b, c))


def _poisson_surface(cloud: PointCloud, depth: int) -> TriangleMesh:
    """The screened Poisson surface; if it is not closed, as where a body stands, that in a larger cube."""
    for scale in (FILL_SCALE, BASE_SCALE):
        vertices, faces, _ = open3d.poisson(cloud.points, normals_of(cloud), depth=depth, scale=scale)
        if not len(faces):
            raise ReconstructionError(f"Poisson reconstruction of {len(cloud.points)} points gave no surface")
        surface = compact(vertices, faces)
        largest, _ = largest_component(surface, 1.0)
        if not (n_open := defects(largest).boundary_edges):
            return surface
    raise ReconstructionError(
        f"the points must surround a body, their surface has {n_open} boundary edges: "
        "scan the sides that are missing, or merge this view with others"
    )
