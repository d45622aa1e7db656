"""Oriented points → signed distance to their surface, on the cells of a grid near them."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pcretrieve.errors import ReconstructionError
from pcretrieve.scan.outside import Outside
from pcretrieve.types import FloatArray, PointCloud

__all__ = ["LEAST_WEIGHT", "distance_field", "folded", "hidden_below", "normals_of"]

Mask = NDArray[np.bool_]
Voxels = NDArray[np.float32]

# Each cell sees the points this far round itself, weighted by a Gaussian; cells.
REACH = 3.0
SPREAD = 1.5

# How much of the curvature of the fitted sphere is believed: β of the source. 0 shrinks limbs and loses
# fingers, the mean distance to the tangent planes (no sphere at all) swells tails and hands by half their
# area. Human scans of TOSCA, log-signature error: planes .435, β = .5 .417, 1 .414, 1.6 .329, 2.2 .333.
CURVATURE = 1.6

# Points that lie closer together than this, as a share of a cell², tell no curvature.
LEAST_EXTENT = 0.25

# Least sum of weights that a distance is believed at: about that of one point at the end of its reach.
LEAST_WEIGHT = 0.15

# A point without a sensor is part of the surface only where the outside comes this near; relative to the
# diagonal, and to cells where those are coarse. Deeper ones lie in contacts and closed mouths, where no side
# can be told from the other.
HIDDEN = 0.02
HIDDEN_CELLS = 4.5

# Such points are a fold, and left out of the surface, where they are at least this many cells, and less than
# this share of the cells round them is outside. A contact of limbs is open all along its rim (.15 to .49 in
# TOSCA), a closed mouth only at the lips (.02 to .13).
LEAST_FOLD = 100
LEAST_OPEN = 0.135


def distance_field(cloud: PointCloud, outside: Outside) -> tuple[Voxels, Voxels]:
    """Distance to the algebraic sphere that fits the points and normals near each cell [1]_.

    Parameters
    ----------
    cloud : PointCloud
        With normals.
    outside : Outside
        Points without a sensor that it does not come near to are left out.

    Returns
    -------
    distance : float32 array of the grid's shape
        Negative inside; cells. 0 where no point is near.
    weight : float32 array of the grid's shape
        Of the points near each cell: about 1 for each next to it.

    References
    ----------
    .. [1] Guennebaud and Gross, "Algebraic point set surfaces", ACM Transactions on Graphics 26 (2007),
       equation (4) of "Dynamic sampling and rendering of algebraic point set surfaces" (2008) for the fit.
    """
    shown = ~_hidden(cloud, outside)
    points, normals = cloud.points[shown], normals_of(cloud)[shown]
    at, shape = outside.grid.coordinates(points), outside.grid.shape
    near = np.flatnonzero(_near(at, shape))
    number = np.full(shape, -1, dtype=np.int32)
    number.ravel()[near] = np.arange(len(near), dtype=np.int32)
    fitted = _fitted(_summed(at, normals, number, len(near)))  # (k, 2)
    field = np.zeros((2, *shape), dtype=np.float32)
    field.reshape(2, -1)[:, near] = fitted.T
    return field[0], field[1]


def normals_of(cloud: PointCloud) -> FloatArray:
    """The normals of a cloud that must have some.

    Raises
    ------
    ReconstructionError
        If it has none.
    """
    if cloud.normals is None:
        raise ReconstructionError("reconstruction needs points with normals, these have none")
    return cloud.normals


def folded(cloud: PointCloud, outside: Outside, inside: Mask) -> Mask:
    """(n,) points of skin that is folded in, as in a closed mouth: hidden, many, and hardly open anywhere."""
    from scipy import ndimage

    grid = outside.grid
    hidden = _hidden(cloud, outside)
    if not hidden.any():
        return hidden
    places = np.array(grid.index(cloud.points[hidden]))  # (3, h)
    # With two cells round them, which the grid has: one for the fold, one for its rim.
    low, high = places.min(axis=1) - 2, places.max(axis=1) + 3
    nearby = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
    fold = np.zeros(high - low, dtype=bool)
    fold[tuple(places - low[:, None])] = True
    fold = ndimage.binary_dilation(fold)
    pieces, n = ndimage.label(fold, np.ones((3, 3, 3)))
    closed = np.zeros(n + 1, dtype=bool)
    for piece, box in enumerate(ndimage.find_objects(pieces), start=1):
        wider = tuple(slice(side.start - 1, side.stop + 1) for side in box)
        cells = pieces[wider] == piece
        rim = ndimage.binary_dilation(cells) & ~cells
        closed[piece] = (
            cells.sum() >= LEAST_FOLD and (rim & ~inside[nearby][wider]).sum() < LEAST_OPEN * rim.sum()
        )
    found = np.zeros(len(cloud.points), dtype=bool)
    found[hidden] = closed[pieces[tuple(places - low[:, None])]]
    return found


def _hidden(cloud: PointCloud, outside: Outside) -> Mask:
    """(n,) points that the outside does not come near to, nor any sensor saw."""
    if cloud.viewpoints is not None:
        return np.zeros(len(cloud.points), dtype=bool)
    return np.asarray(outside.depth_at(cloud.points) > hidden_below(cloud.diagonal, outside.grid.cell))


def hidden_below(diagonal: float, cell: float) -> float:
    """Depth below the outside from which points without a sensor are hidden; cells."""
    return max(HIDDEN_CELLS, HIDDEN * diagonal / cell)


@njit(cache=True)
def _near(at: FloatArray, shape: tuple[int, int, int]) -> Mask:
    """Cells that some point reaches."""
    near = np.zeros(shape, dtype=np.bool_)
    for i in range(len(at)):
        x, y, z = at[i]
        for u in range(max(0, int(np.ceil(x - REACH))), min(shape[0], int(x + REACH) + 1)):
            for v in range(max(0, int(np.ceil(y - REACH))), min(shape[1], int(y + REACH) + 1)):
                for w in range(max(0, int(np.ceil(z - REACH))), min(shape[2], int(z + REACH) + 1)):
                    if (u - x) ** 2 + (v - y) ** 2 + (w - z) ** 2 <= REACH * REACH:
                        near[u, v, w] = True
    return near


@njit(cache=True)
def _summed(at: FloatArray, normals: FloatArray, number: NDArray[np.int32], n: int) -> FloatArray:
    """(n, 9) sums over the points p near each numbered cell, seen from there: w, wp, wn, wp·p, wp·n."""
    shape = number.shape
    sums = np.zeros((n, 9))
    for i in range(len(at)):
        x, y, z = at[i]
        for u in range(max(0, int(np.ceil(x - REACH))), min(shape[0], int(x + REACH) + 1)):
            for v in range(max(0, int(np.ceil(y - REACH))), min(shape[1], int(y + REACH) + 1)):
                for w in range(max(0, int(np.ceil(z - REACH))), min(shape[2], int(z + REACH) + 1)):
                    a, b, c = x - u, y - v, z - w
                    square = a * a + b * b + c * c
                    if square > REACH * REACH:
                        continue
                    weight = np.exp(-square / (2 * SPREAD * SPREAD))
                    k = number[u, v, w]
                    sums[k, 0] += weight
                    sums[k, 1] += weight * a
                    sums[k, 2] += weight * b
                    sums[k, 3] += weight * c
                    sums[k, 4] += weight * normals[i, 0]
                    sums[k, 5] += weight * normals[i, 1]
                    sums[k, 6] += weight * normals[i, 2]
                    sums[k, 7] += weight * square
                    sums[k, 8] += weight * (a * normals[i, 0] + b * normals[i, 1] + c * normals[i, 2])
    return sums


def _fitted(sums: FloatArray) -> FloatArray:
    """(n, 2) distances to the sphere u₀ + u·p + q p·p = 0 that fits each row of sums, and their weights."""
    weight, points, normals = sums[:, 0], sums[:, 1:4], sums[:, 4:7]
    extent = sums[:, 7] - np.einsum("ij,ij->i", points, points) / weight
    turn = sums[:, 8] - np.einsum("ij,ij->i", points, normals) / weight
    q = np.where(extent > LEAST_EXTENT * weight, CURVATURE * turn / (2 * np.maximum(extent, 1e-9)), 0)
    u = (normals - 2 * q[:, None] * points) / weight[:, None]
    u_0 = -(np.einsum("ij,ij->i", u, points) + q * sums[:, 7]) / weight
    # The root of u₀ + |u| d + q d² that does not vanish with q; beyond the centre, that of the centre.
    steepness = np.linalg.norm(u, axis=1)
    root = np.sqrt(np.maximum(steepness**2 - 4 * u_0 * q, 0))
    return np.column_stack([2 * u_0 / (steepness + root + 1e-9), weight])
