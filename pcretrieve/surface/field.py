"""Oriented points → signed distance to their surface (algebraic point set surface) in voxels near them."""

from __future__ import annotations

import numpy as np
from numba import njit

from pcretrieve.errors import ReconstructionError
from pcretrieve.points.grid import Mask, Voxels
from pcretrieve.points.outside import Outside
from pcretrieve.values import FloatArray, IntArray, PointCloud

# Radius of the neighbourhood of a voxel, and standard deviation of the Gaussian
# weight of its points; in voxels.
REACH = 3.0
SPREAD = 1.5

# β of the fit (Guennebaud et al. 2008): the factor of the quadratic coefficient of the fitted sphere. β = 1
# is the least-squares sphere, β = 0 a plane. Small β shrinks thin limbs.
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
# fold is mostly closed.
LEAST_FOLD = 100
LEAST_OPEN = 0.135


def distance_field(cloud: PointCloud, outside: Outside) -> Voxels:
    """Signed distance to the algebraic sphere that is fitted to the points near each voxel [1]_ [2]_.

    In voxels; NaN far from the points.

    References
    ----------
    .. [1] G. Guennebaud and M. Gross, "Algebraic point set surfaces", ACM Transactions on Graphics 26 (2007).
    .. [2] G. Guennebaud, M. Germann and M. Gross, "Dynamic sampling and rendering of algebraic point set
       surfaces", Computer Graphics Forum 27 (2008), equation (4).
    """
    shown = ~_hidden(cloud, outside)
    at = outside.grid.coordinates(cloud.points[shown])
    return _fitted(at, normals_of(cloud)[shown], outside.distance)


def normals_of(cloud: PointCloud) -> FloatArray:
    """The (n, 3) normals of a cloud, which must have normals."""
    if cloud.normals is None:
        raise ReconstructionError("reconstruction needs points with normals, these have none")
    return cloud.normals


def folded(cloud: PointCloud, outside: Outside, inside: Mask) -> Mask:
    """(n,) mask of the points of folds, such as closed mouths: large, hardly open pieces of hidden points."""
    grid = outside.grid
    hidden = _hidden(cloud, outside)
    if not hidden.any():
        return hidden
    from scipy import ndimage

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
        n_open = (rim & ~inside[nearby][wider]).sum()
        closed[piece] = cells.sum() >= LEAST_FOLD and n_open < LEAST_OPEN * rim.sum()
    found = np.zeros(len(cloud.points), dtype=bool)
    found[hidden] = closed[pieces[tuple(places - low[:, None])]]
    return found


def _hidden(cloud: PointCloud, outside: Outside) -> Mask:
    """(n,) mask of hidden points: far from the outside; none if the positions of the sensors are known."""
    if cloud.viewpoints is not None:
        return np.zeros(len(cloud.points), dtype=bool)
    return np.asarray(
        outside.depth_at(cloud.points) > hidden_below(cloud.diagonal, outside.grid.cell)
    )


def hidden_below(diagonal: float, cell: float) -> float:
    """The depth below the outside from which points are hidden; in voxels."""
    return max(HIDDEN_CELLS, HIDDEN * diagonal / cell)


@njit(cache=True, error_model="numpy")
def _fitted(at: FloatArray, normals: FloatArray, to_points: Voxels) -> Voxels:
    """Distances to the sphere u₀ + u·p + q p·p = 0 that is fitted near each voxel."""
    distance = np.full(to_points.shape, np.nan, dtype=np.float32)
    # The number, in order, of each voxel that may have a point within `REACH`: a point is at most half a
    # diagonal of a voxel away from the centre of its own voxel.
    numbers, n = np.full(to_points.size, -1, dtype=np.int32), 0
    for i, away in enumerate(to_points.ravel()):
        if away <= REACH + np.sqrt(3) / 2:
            numbers[i] = n
            n += 1
    number = numbers.reshape(to_points.shape)
    sums = _summed(at, normals, number, n)
    n_x, n_y, n_z = to_points.shape
    for x in range(n_x):
        for y in range(n_y):
            for z in range(n_z):
                k = number[x, y, z]
                if k < 0 or np.float32(sums[k, 0]) <= np.float32(LEAST_WEIGHT):
                    continue
                w, p, r, s = sums[k, 0], sums[k, 1], sums[k, 2], sums[k, 3]
                d, e, f = sums[k, 4], sums[k, 5], sums[k, 6]
                # The sums relative to the centre of the voxel.
                a, b, c = p - x * w, r - y * w, s - z * w
                squares = sums[k, 7] - x * (p + a) - y * (r + b) - z * (s + c)
                along = sums[k, 8] - x * d - y * e - z * f
                extent = squares - (a * a + b * b + c * c) / w
                q = 0.0
                if extent > LEAST_EXTENT * w:
                    q = CURVATURE * (along - (a * d + b * e + c * f) / w) / (2 * extent)
                u, v, t = (d - 2 * q * a) / w, (e - 2 * q * b) / w, (f - 2 * q * c) / w
                u_0 = -(u * a + v * b + t * c + q * squares) / w
                # Minus the root d of u₀ + |u| d + q d² that stays finite as q → 0; if it is not real, the
                # distance to the centre of the sphere.
                steepness = np.sqrt(u * u + v * v + t * t)
                root = np.sqrt(max(steepness * steepness - 4 * u_0 * q, 0))
                distance[x, y, z] = 2 * u_0 / (steepness + root + 1e-9)
    return distance


@njit(cache=True, error_model="numpy")
def _summed(at: FloatArray, normals: FloatArray, number: IntArray, n: int) -> FloatArray:
    """(n, 9) sums of the weights w, and of w p, w n, w p·p, w p·n over the points p near each voxel."""
    n_x, n_y, n_z = number.shape
    sums = np.zeros(9 * n)
    # The Gaussian weight is a product of factors for the axes. The terms of one line of voxels, up to the
    # factors of the two other axes, are contiguous, as the sums are, so that several are added at once.
    side = int(2 * REACH) + 2
    of_y, terms = np.empty(side), np.empty(9 * side)
    narrow = 1 / (2 * SPREAD * SPREAD)
    for i in range(len(at)):
        x, y, z = at[i, 0], at[i, 1], at[i, 2]
        a, b, c = normals[i, 0], normals[i, 1], normals[i, 2]
        square, along = x * x + y * y + z * z, x * a + y * b + z * c
        v_low, v_high = max(0, int(np.ceil(y - REACH))), min(n_y, int(y + REACH) + 1)
        w_low, w_high = max(0, int(np.ceil(z - REACH))), min(n_z, int(z + REACH) + 1)
        for v in range(v_low, v_high):
            of_y[v - v_low] = np.exp(-narrow * (y - v) ** 2)
        for w in range(w_low, w_high):
            of_z, t = np.exp(-narrow * (z - w) ** 2), 9 * (w - w_low)
            terms[t], terms[t + 1], terms[t + 2], terms[t + 3] = of_z, of_z * x, of_z * y, of_z * z
            terms[t + 4], terms[t + 5], terms[t + 6] = of_z * a, of_z * b, of_z * c
            terms[t + 7], terms[t + 8] = of_z * square, of_z * along
        for u in range(max(0, int(np.ceil(x - REACH))), min(n_x, int(x + REACH) + 1)):
            of_x = np.exp(-narrow * (x - u) ** 2)
            for v in range(v_low, v_high):
                rest = REACH * REACH - (x - u) ** 2 - (y - v) ** 2
                if rest < 0:
                    continue
                first, last = w_low, w_high
                while first < last and (first - z) ** 2 > rest:
                    first += 1
                while first < last and (last - 1 - z) ** 2 > rest:
                    last -= 1
                of_line = of_x * of_y[v - v_low]
                if first < last:  # the numbers of the voxels on this line are consecutive
                    here, begin = np.uint64(9 * number[u, v, first]), np.uint64(9 * (first - w_low))
                    # Numba need not test whether an index without a sign counts from the end of an array.
                    for j in range(np.uint64(9 * (last - first))):
                        sums[here + j] += of_line * terms[begin + j]
    return sums.reshape(n, 9)
