"""Oriented points → signed distance to their surface (algebraic point set surface) in voxels near them."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pcretrieve.errors import ReconstructionError
from pcretrieve.types import FloatArray, PointCloud
from pcretrieve.voxels import Mask, Outside, Voxels

__all__ = ["LEAST_WEIGHT", "distance_field", "folded", "hidden_below", "normals_of"]


# Radius of the neighbourhood of a voxel, and standard deviation of the Gaussian
# weight of its points; in voxels.
REACH = 3.0
SPREAD = 1.5

# β of the fit (Guennebaud et al. 2008): the factor of the quadratic coefficient of the fitted sphere. β = 1
# is the least-squares sphere, β = 0 a plane. Small β shrinks thin limbs. See docs/decisions.md, CURVATURE.
CURVATURE = 1.6

# Smallest weighted variance of the points of a neighbourhood for a sphere to be fitted, in voxels². Otherwise
# a plane is fitted.
LEAST_EXTENT = 0.25

# Smallest sum of weights for a distance to be used: about the weight of one point at the distance REACH.
LEAST_WEIGHT = 0.15

# Largest depth below the outside of a point of the surface, if its sensor is not known: the larger of a
# length relative to the diagonal and a length in voxels. Deeper ("hidden") points lie at contacts and in
# closed mouths, where the direction of the outside is ambiguous.
HIDDEN = 0.02
HIDDEN_CELLS = 4.5

# A component of hidden points is a fold, such as a closed mouth, if it has at least this many voxels and at
# most this fraction of the voxels around it is outside. The rim of a contact between limbs is open, that of a
# fold is mostly closed. See docs/decisions.md, LEAST_OPEN.
LEAST_FOLD = 100
LEAST_OPEN = 0.135


def distance_field(cloud: PointCloud, outside: Outside) -> tuple[Voxels, Voxels]:
    """Signed distance to the algebraic sphere that is fitted to the points near each voxel [1]_ [2]_.

    Parameters
    ----------
    cloud : PointCloud
        Points with normals.
    outside : Outside
        The outside of the body. Hidden points are not used.

    Returns
    -------
    distance : float32 array of the shape of the grid
        Negative inside; in voxels. 0 far from the points.
    weight : float32 array of the shape of the grid
        Sum of the Gaussian weights of the points near each voxel; at most 1 for each point.

    Raises
    ------
    ReconstructionError
        If the points have no normals.

    References
    ----------
    .. [1] G. Guennebaud and M. Gross, "Algebraic point set surfaces", ACM Transactions on Graphics 26 (2007).
    .. [2] G. Guennebaud, M. Germann and M. Gross, "Dynamic sampling and rendering of algebraic point set
       surfaces", Computer Graphics Forum 27 (2008), equation (4).
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
    """The normals of a cloud, which must have normals.

    Parameters
    ----------
    cloud : PointCloud
        Points with normals.

    Returns
    -------
    (n, 3) float64
        Unit normals.

    Raises
    ------
    ReconstructionError
        If the cloud has no normals.
    """
    if cloud.normals is None:
        raise ReconstructionError("reconstruction needs points with normals, these have none")
    return cloud.normals


def folded(cloud: PointCloud, outside: Outside, inside: Mask) -> Mask:
    """The points of folds, such as closed mouths: large components of hidden points that are hardly open.

    Parameters
    ----------
    cloud : PointCloud
        n points with normals.
    outside : Outside
        The outside of the body.
    inside : bool array of the shape of the grid
        The voxels inside the body.

    Returns
    -------
    (n,) bool
        The points of folds.
    """
    from scipy import ndimage

    grid = outside.grid
    hidden = _hidden(cloud, outside)
    if not hidden.any():
        return hidden
    places = np.array(grid.index(cloud.points[hidden]))  # (3, h)
    # The bounding box of the hidden points, enlarged by one voxel for the dilation and one for the rim.
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
    """(n,) mask of hidden points: far from the outside; none if the positions of the sensors are known."""
    if cloud.viewpoints is not None:
        return np.zeros(len(cloud.points), dtype=bool)
    return np.asarray(outside.depth_at(cloud.points) > hidden_below(cloud.diagonal, outside.grid.cell))


def hidden_below(diagonal: float, cell: float) -> float:
    """The depth below the outside from which points are hidden.

    Parameters
    ----------
    diagonal : float
        Diagonal of the bounding box; unit of the file.
    cell : float
        Edge of a voxel; unit of the file.

    Returns
    -------
    float
        In voxels.
    """
    return max(HIDDEN_CELLS, HIDDEN * diagonal / cell)


@njit(cache=True)
def _near(at: FloatArray, shape: tuple[int, int, int]) -> Mask:
    """Voxels with a point at a distance of at most `REACH`."""
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
    """(n, 9) sums of w, w p, w n, w p·p, w p·n over the points p near each voxel, relative to its centre."""
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
    """(n, 2) distances to the sphere u₀ + u·p + q p·p = 0 fitted to each row of sums, and the weights."""
    weight, points, normals = sums[:, 0], sums[:, 1:4], sums[:, 4:7]
    extent = sums[:, 7] - np.einsum("ij,ij->i", points, points) / weight
    turn = sums[:, 8] - np.einsum("ij,ij->i", points, normals) / weight
    q = np.where(extent > LEAST_EXTENT * weight, CURVATURE * turn / (2 * np.maximum(extent, 1e-9)), 0)
    u = (normals - 2 * q[:, None] * points) / weight[:, None]
    u_0 = -(np.einsum("ij,ij->i", u, points) + q * sums[:, 7]) / weight
    # Minus the root d of u₀ + |u| d + q d² that stays finite as q → 0; if it is not real, the distance to the
    # centre of the sphere.
    steepness = np.linalg.norm(u, axis=1)
    root = np.sqrt(np.maximum(steepness**2 - 4 * u_0 * q, 0))
    return np.column_stack([2 * u_0 / (steepness + root + 1e-9), weight])
