"""Points whose density varies over the body: which of them are sparse, and places between them.

A scanner measures few points where a surface is far away, dark, or inclined. All later stages work at the
scale of one voxel, at which sparse points are isolated. Between them, points are therefore interpolated, for
the walls of the flood fill and for the reconstruction of the surface (`surface.poisson.interpolated`). The
points of a scan themselves do not change, and nothing is interpolated in a scan of uniform density.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pcretrieve.arrays import tangent_axes
from pcretrieve.points.neighbors import (
    SAME_SIDE,
    SPACING_NEIGHBORS,
    Neighborhoods,
    nearest,
    voxel_numbers,
)
from pcretrieve.values import FloatArray, Mask

# Spacing from which a point is sparse, in voxels; and the smallest fraction of the surface that sparse points
# represent for points to be interpolated.
SPARSE = 2.0
LEAST_SPARSE = 0.05

# Largest spacing of points between which points are interpolated, relative to the diagonal.
FARTHEST = 0.1

# Radius of the disk around a sparse point, in spacings: disks of one spacing would leave gaps.
RADIUS = 1.5

# The distance of neighbour k is proportional to k^(1/2) on a surface, and to k^(1/3) in a volume; the
# exponent is near 0 for a point off a dense surface. It is measured between the neighbours SPACING_NEIGHBORS
# and FARTHER. The smallest one of points of a surface.
FARTHER = 20
LEAST_GROWTH = 0.39

# Smallest spacing of the points that are compared, in medians: no point of a scan of uniform density has one.
UNCOMMON = 1.8

# Smallest exponent of a single point, if the median is that of a surface, and fewest points for a median.
LEAST_OF_ONE = 0.15
FEWEST = 5

# Number of neighbours to which a sphere is fitted, and number of times that a point is moved to its sphere.
FITTED = 16
ROUNDS = 2

# Smallest distance of an interpolated point from a measured one, in voxels.
APART = 0.7

# The golden angle, by which successive points of a spiral are turned; radians.
GOLDEN = np.pi * (3 - np.sqrt(5))


def local_spacings(neighbors: Neighborhoods, k: int = SPACING_NEIGHBORS) -> FloatArray:
    """(m,) square roots of the area of surface for one point near each point; `spacing` is the median.

    k: the neighbour by whose distance the area is estimated.
    """
    k = min(k, neighbors.distance.shape[1] - 1)
    return np.asarray(np.sqrt(np.pi / k) * neighbors.distance[:, k])


def sparse_points(neighbors: Neighborhoods, *, cell: float, diagonal: float) -> Mask:
    """(n,) mask of the points whose spacing is so much larger than a voxel that points must be interpolated.

    None are if they represent a small part of the surface, or are not on a surface.

    cell: edge of the voxels, not smaller than the median of the spacings.
    """
    sparse = many_sparse(local_spacings(neighbors), cell, diagonal)
    if sparse.any() and not _is_surface(neighbors, least=SPARSE * cell):
        return np.zeros_like(sparse)
    return sparse


def many_sparse(
    spacings: FloatArray, cell: float, diagonal: float, *, least: float = LEAST_SPARSE
) -> Mask:
    """(n,) mask of the points that are sparse; none, if they represent at most so much of the surface."""
    known = spacings < FARTHEST * diagonal
    sparse = known & (spacings > SPARSE * cell)
    share = (spacings[sparse] ** 2).sum() / max(
        (spacings[known] ** 2).sum(), np.finfo(float).tiny
    )
    return sparse if share > least else np.zeros_like(sparse)


def _growth(neighbors: Neighborhoods) -> FloatArray:
    """(n,) exponents a of the distance of neighbour k, which is proportional to k^a."""
    near, far = (
        min(k, neighbors.distance.shape[1] - 1) for k in (SPACING_NEIGHBORS, FARTHER)
    )
    ratio = neighbors.distance[:, far] / np.maximum(
        neighbors.distance[:, near], np.finfo(float).tiny
    )
    return np.asarray(np.log(np.maximum(ratio, 1)) / np.log(far / near))


def _is_surface(neighbors: Neighborhoods, *, least: float) -> bool:
    """Whether the points with at least some spacing are, in the median, on a surface."""
    # By the farther distance: a nearer one would select points whose distances grow slowly.
    sparse = local_spacings(neighbors, FARTHER) > least
    return bool(
        sparse.sum() >= FEWEST and np.median(_growth(neighbors)[sparse]) > LEAST_GROWTH
    )


def is_of_surface(neighbors: Neighborhoods, *, cell: float) -> Mask:
    """(n,) mask of the points that are not isolated; none, if the sparse points are not those of a surface.

    The number of points within a distance r of a point of a surface is proportional to r². Around outliers,
    which are in a volume, or isolated before a dense surface, it grows faster.

    cell: smallest edge of later voxels.
    """
    median = float(np.median(local_spacings(neighbors, FARTHER)))
    if not _is_surface(neighbors, least=UNCOMMON * max(cell, median)):
        return np.zeros(len(neighbors.distance), dtype=np.bool_)
    return _growth(neighbors) > LEAST_OF_ONE


def disks(
    points: FloatArray,
    normals: FloatArray,
    spacings: FloatArray,
    sparse: Mask,
    *,
    step: float,
) -> tuple[FloatArray, NDArray[np.intp]]:
    """Points on disks around sparse points, in their tangent planes.

    normals: (n, 3) float64, unit normals of either sign.
    step: distance between the points on a disk.
    Returns points, centres: (k, 3) points, one for each voxel of the edge `step`; and (k,) indices of the
        sparse points on whose disks they are.
    """
    centres = np.flatnonzero(sparse)
    radius = RADIUS * spacings[centres]
    n = np.maximum(1, np.pi * (radius / step) ** 2).astype(np.intp)
    which = np.repeat(np.arange(len(centres)), n)
    # A spiral of Vogel, whose points have equal areas.
    number = np.arange(n.sum()) - np.repeat(np.cumsum(n) - n, n)
    out = radius[which] * np.sqrt((number + 0.5) / n[which])
    first, second = tangent_axes(normals[centres])
    turn = GOLDEN * number
    across, up = (out * np.cos(turn))[:, None], (out * np.sin(turn))[:, None]
    placed = points[centres[which]] + across * first[which] + up * second[which]
    kept = _one_a_voxel(placed, step)
    return placed[kept], centres[which[kept]]


def on_spheres(
    points: FloatArray,
    normals: FloatArray,
    spacings: FloatArray,
    sparse: Mask,
    *,
    step: float,
) -> tuple[FloatArray, FloatArray, NDArray[np.intp]]:
    """Points on spheres around sparse points, their normals, and the indices of the sparse points.

    The algebraic spheres are fitted to the nearest points of the same side [1]_.

    step: distance between the further points.

    References
    ----------
    .. [1] G. Guennebaud and M. Gross, "Algebraic point set surfaces", ACM Transactions on Graphics 26 (2007).
    """
    placed, centres = disks(points, normals, spacings, sparse, step=step)
    outward = normals[centres]
    for _ in range(ROUNDS):
        distance, near = nearest(points, placed, min(FITTED, len(points)))
        agreement = np.einsum("ij,ikj->ik", normals[centres], normals[near])
        weight = np.clip(1 - (distance / distance[:, -1:]) ** 2, 0, 1) ** 2
        weight *= np.clip((agreement - SAME_SIDE) / (1 - SAME_SIDE), 0, 1)
        height, outward = _sphere(points[near] - placed[:, None], normals[near], weight)
        limit = RADIUS * spacings[centres]
        placed = placed - np.clip(height, -limit, limit)[:, None] * outward
    distance, near = nearest(points, placed, 1)  # (k, 1)
    usable = (distance > APART * step) & (distance < RADIUS * spacings[near])
    usable &= np.einsum("ij,ikj->ik", outward, normals[near]) > 0
    usable = usable[:, 0]
    placed, outward, centres = placed[usable], outward[usable], centres[usable]
    kept = _one_a_voxel(placed, step)
    return placed[kept], outward[kept], centres[kept]


def _sphere(
    apart: FloatArray, normals: FloatArray, weight: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Heights of the origin above spheres u₀ + u·p + q p·p = 0 fitted to (n, k, 3) points, and normals."""
    total = weight.sum(axis=1) + np.finfo(float).tiny
    middle = np.einsum("nk,nkd->nd", weight, apart)
    summed = np.einsum("nk,nkd->nd", weight, normals)
    squares = np.einsum("nk,nkd,nkd->n", weight, apart, apart)
    turn = (
        np.einsum("nk,nkd,nkd->n", weight, apart, normals)
        - (middle * summed).sum(axis=1) / total
    )
    extent = squares - (middle**2).sum(axis=1) / total
    q = np.divide(
        turn, 2 * extent, out=np.zeros_like(turn), where=extent > 1e-9 * squares
    )
    u = (summed - 2 * q[:, None] * middle) / total[:, None]
    u_0 = -((u * middle).sum(axis=1) + q * squares) / total
    steepness = np.linalg.norm(u, axis=1)
    root = np.sqrt(np.maximum(steepness**2 - 4 * u_0 * q, 0))
    height = np.divide(
        2 * u_0, steepness + root, out=np.zeros_like(u_0), where=steepness > 0
    )
    return height, u / np.maximum(steepness, np.finfo(float).tiny)[:, None]


def _one_a_voxel(points: FloatArray, edge: float) -> NDArray[np.intp]:
    """Indices of the first point in each voxel."""
    if not len(points):
        return np.zeros(0, dtype=np.intp)
    return np.unique(voxel_numbers(points, edge), return_index=True)[1]
