"""Oriented points → signed distance to their surface (algebraic point set surface) in voxels near them."""

from __future__ import annotations

import numpy as np

from pcretrieve.errors import ReconstructionError
from pcretrieve.points.voxels import Outside, Voxels
from pcretrieve.values import FloatArray, IntArray, Mask, PointCloud
from pcretrieve.values.compiled import compiled, inlined, inner

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
HIDDEN = 0.035
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
        raise ReconstructionError(
            "reconstruction needs points with normals, these have none"
        )
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
    return outside.depth_at(cloud.points) > hidden_below(
        cloud.diagonal, outside.grid.cell
    )


def hidden_below(diagonal: float, cell: float) -> float:
    """The depth below the outside from which points are hidden; in voxels."""
    return max(HIDDEN_CELLS, HIDDEN * diagonal / cell)


# --- the compiled fit ------------------------------------------------------------------------------------
#
# A voxel looks at the points within `REACH`, and fits to them the sphere whose gradient at the points is
# nearest to their normals, in weighted least squares. Such a sphere has a closed form in nine sums over the
# points. So one pass over the points collects the sums of all voxels, and one over the voxels solves for the
# spheres.

# The factor in the exponent of the Gaussian weight.
NARROWNESS = 1 / (2 * SPREAD * SPREAD)

Vector = tuple[float, float, float]


@compiled(error_model="numpy")
def _fitted(points: FloatArray, normals: FloatArray, to_points: Voxels) -> Voxels:
    """Distances from each voxel to the sphere that is fitted near it; NaN where there are too few points.

    points: (n, 3) in voxels. to_points: the distance from each voxel to the nearest voxel with a point.
    """
    distance = np.full(to_points.shape, np.nan, dtype=np.float32)
    number, n = _numbered(to_points)
    sums = _summed(points, normals, number, n)
    n_x, n_y, n_z = to_points.shape
    for x in range(n_x):
        for y in range(n_y):
            for z in range(n_z):
                k = number[x, y, z]
                if k < 0 or np.float32(sums[k, 0]) <= np.float32(LEAST_WEIGHT):
                    continue
                distance[x, y, z] = _to_sphere(sums[k], x, y, z)
    return distance


@inner()
def _numbered(to_points: Voxels) -> tuple[IntArray, int]:
    """The number, in order, of each voxel that may have a point within `REACH`, else −1; and how many."""
    number, n = np.full(to_points.size, -1, dtype=np.int32), 0
    for i, away in enumerate(to_points.ravel()):
        # A point is at most half a diagonal of a voxel away from the centre of its own voxel.
        if away <= REACH + np.sqrt(3) / 2:
            number[i] = n
            n += 1
    return number.reshape(to_points.shape), n


@inner(error_model="numpy")
def _to_sphere(sums: FloatArray, x: int, y: int, z: int) -> float:
    """The distance from a voxel to the sphere u₀ + u·p + q p·p = 0 of the sums (9,) over its points."""
    weight = sums[0]
    normal = sums[4], sums[5], sums[6]  # Σ w n
    # Relative to the centre of the voxel: Σ w p, Σ w p·p and Σ w p·n.
    offset = sums[1] - x * weight, sums[2] - y * weight, sums[3] - z * weight
    squares = (
        sums[7]
        - x * (sums[1] + offset[0])
        - y * (sums[2] + offset[1])
        - z * (sums[3] + offset[2])
    )
    along = sums[8] - x * normal[0] - y * normal[1] - z * normal[2]
    extent = squares - _dot(offset, offset) / weight
    q = 0.0
    if extent > LEAST_EXTENT * weight:
        q = CURVATURE * (along - _dot(offset, normal) / weight) / (2 * extent)
    u = (
        (normal[0] - 2 * q * offset[0]) / weight,
        (normal[1] - 2 * q * offset[1]) / weight,
        (normal[2] - 2 * q * offset[2]) / weight,
    )
    u_0 = -(_dot(u, offset) + q * squares) / weight
    # Minus the root d of u₀ + |u| d + q d² that stays finite as q → 0; if it is not real, the distance to the
    # centre of the sphere.
    steepness = np.sqrt(_dot(u, u))
    root = np.sqrt(max(steepness * steepness - 4 * u_0 * q, 0))
    return float(2 * u_0 / (steepness + root + 1e-9))


@inner()
def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inner(error_model="numpy")
def _summed(
    points: FloatArray, normals: FloatArray, number: IntArray, n: int
) -> FloatArray:
    """(n, 9) sums of the weights w, and of w p, w n, w p·p, w p·n over the points p near each voxel.

    The Gaussian weight is a product of factors for the axes. The terms that a point adds to one line of
    voxels along z, but for the factors of x and y, are therefore the same on all lines. They are contiguous,
    as the sums are, so that several are added at once.
    """
    sums = np.zeros(9 * n)
    side = int(2 * REACH) + 2
    terms, of_y = np.empty(9 * side), np.empty(side)
    for i in range(len(points)):
        _set_terms(terms, points[i], normals[i], number.shape[2])
        _add_terms(sums, terms, of_y, points[i], number)
    return sums.reshape(n, 9)


@inner()
def _reached(place: float, n: int) -> tuple[int, int]:
    """The first of n voxels on a line within `REACH` of a place, and the one after the last."""
    return max(0, int(np.ceil(place - REACH))), min(n, int(place + REACH) + 1)


@inlined()
def _set_terms(
    terms: FloatArray, point: FloatArray, normal: FloatArray, n_z: int
) -> None:
    """Set the nine terms of a point for each voxel that it reaches on a line along z."""
    x, y, z = point
    square = x * x + y * y + z * z
    along = x * normal[0] + y * normal[1] + z * normal[2]
    first, last = _reached(z, n_z)
    for voxel in range(first, last):
        factor = np.exp(-NARROWNESS * (z - voxel) ** 2)
        t = 9 * (voxel - first)
        terms[t] = factor
        terms[t + 1] = factor * x
        terms[t + 2] = factor * y
        terms[t + 3] = factor * z
        terms[t + 4] = factor * normal[0]
        terms[t + 5] = factor * normal[1]
        terms[t + 6] = factor * normal[2]
        terms[t + 7] = factor * square
        terms[t + 8] = factor * along


@inlined()
def _add_terms(
    sums: FloatArray,
    terms: FloatArray,
    of_y: FloatArray,
    point: FloatArray,
    number: IntArray,
) -> None:
    """Add the terms of a point, by the weights of the lines of voxels, to the sums of voxels in its reach."""
    x, y, z = point
    low, high = _reached(z, number.shape[2])
    reached_y = _reached(y, number.shape[1])
    for v in range(reached_y[0], reached_y[1]):
        of_y[v - reached_y[0]] = np.exp(-NARROWNESS * (y - v) ** 2)
    reached_x = _reached(x, number.shape[0])
    for u in range(reached_x[0], reached_x[1]):
        of_x = np.exp(-NARROWNESS * (x - u) ** 2)
        for v in range(reached_y[0], reached_y[1]):
            rest = REACH * REACH - (x - u) ** 2 - (y - v) ** 2
            first, last = low, high
            while first < last and (first - z) ** 2 > rest:
                first += 1
            while first < last and (last - 1 - z) ** 2 > rest:
                last -= 1
            if first < last:
                # The numbers of the voxels on this line are consecutive.
                here, weight = 9 * number[u, v, first], of_x * of_y[v - reached_y[0]]
                _add_line(sums, here, weight, terms[9 * (first - low) : 9 * (last - low)])


@inlined()
def _add_line(sums: FloatArray, here: int, weight: float, terms: FloatArray) -> None:
    # Numba need not test whether an index without a sign counts from the end of an array.
    start = np.uint64(here)
    for j in range(np.uint64(len(terms))):
        sums[start + j] += weight * terms[j]
