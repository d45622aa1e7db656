"""The points of a cloud that are nearest to given places, compiled by numba."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pcretrieve.arrays import bounds
from pcretrieve.options import ScanOptions
from pcretrieve.values import FloatArray
from pcretrieve.values.compiled import compiled, inlined, inner

Index = NDArray[np.intp]
Order = NDArray[np.int32]
Shape = tuple[int, int, int]

# Mean number of points in an occupied cell of the grid, relative to the number of neighbours, by which most
# neighbourhoods are in a cell and those around it; and its smallest value.
OCCUPANCY = 0.25
LEAST_OCCUPANCY = 4.0

# Largest number of points in one cell, relative to the wanted mean, and largest number of cells for each
# point. Beyond them the density varies so much that a k-d tree is faster than a grid.
MOST_CROWDED = 40
MOST_CELLS = 64

# Largest number of cells, which take 67 MB. Only scans of a million points and more would have smaller cells.
LARGEST_GRID = 1 << 24

# Two distances that are nearer than this, relatively, are equal up to rounding errors.
ROUNDING = 1e-9

# The smallest normal number, for what must not be zero.
TINY = float(np.finfo(np.float64).tiny)


def nearest(points: FloatArray, places: FloatArray, k: int) -> tuple[FloatArray, Index]:
    """The points that are nearest to each of (m, 3) places, by a grid of cells or a k-d tree.

    Returns distance, near : (m, k): distances, ascending, and numbers of the points.
    """
    # Both read-only, as most are: numba compiles a function for each kind.
    points, places = (
        np.broadcast_to(points, points.shape),
        np.broadcast_to(places, places.shape),
    )
    cells = _cells(points, k)
    if cells is not None:
        low, edge, shape, order, starts = cells
        found = np.empty((len(places), k)), np.empty((len(places), k), dtype=np.intp)
        grouped, scaled = (points[order] - low) / edge, (places - low) / edge
        _nearest(points, places, grouped, scaled, shape, order, starts, found)
        return found
    from scipy.spatial import cKDTree

    distance, near = cKDTree(points).query(places, k=np.arange(1, k + 1))
    return np.asarray(distance), np.asarray(near)


def _cells(
    points: FloatArray, k: int
) -> tuple[FloatArray, float, Shape, Order, Order] | None:
    """The points, sorted by the cells of a grid of a suitable edge; None if there is no such edge.

    Returns low, edge and shape of the grid, and `order` and `starts` of `_sort`.
    """
    low, high = bounds(points)
    x, y, z = high - low
    wanted = max(OCCUPANCY * k, LEAST_OCCUPANCY)
    # The edge for a box, and then for the number of cells that this edge gives to the surface.
    edge = float(np.sqrt(wanted * (x * y + y * z + z * x) / len(points)))
    least = float(np.cbrt(x * y * z / LARGEST_GRID))
    cells = None
    for _ in range(2):
        if edge < least:
            wanted *= (least / edge) ** 2
            edge = least
        if not edge > 0:
            return None
        numbers = np.floor((high - low) / edge) + 1
        if numbers.prod() > MOST_CELLS * len(points):
            return None
        a, b, c = numbers.astype(int).tolist()
        order, cell = np.empty((2, len(points)), dtype=np.int32)
        starts = np.zeros(a * b * c + 2, dtype=np.int32)
        _sort(order, starts, cell, points, low, edge, (a, b, c))
        cells = low, edge, (a, b, c), order, starts[:-1]
        crowd = np.diff(starts[:-1])
        edge *= float(np.sqrt(wanted * np.count_nonzero(crowd) / len(points)))
    return None if crowd.max() > MOST_CROWDED * wanted else cells


@inner(error_model="numpy")
def _cell(at: float, n: int) -> int:
    return min(max(int(at), 0), n - 1)


@compiled(error_model="numpy")
def _sort(
    order: Order,
    starts: Order,
    cell: Order,
    points: FloatArray,
    low: FloatArray,
    edge: float,
    shape: Shape,
) -> None:
    """Set the (n,) numbers of the points, grouped by cell, and the position of the first one of each cell.

    starts: (cells + 2,), zeros. cell: (n,), for the cell of each point.
    """
    # Two cells ahead, so that the entries are the positions when all points have their places.
    for i in range(len(points)):
        a = _cell((points[i, 0] - low[0]) / edge, shape[0])
        b = _cell((points[i, 1] - low[1]) / edge, shape[1])
        cell[i] = (a * shape[1] + b) * shape[2] + _cell(
            (points[i, 2] - low[2]) / edge, shape[2]
        )
        starts[cell[i] + 2] += 1
    for i in range(2, len(starts)):
        starts[i] += starts[i - 1]
    for i in range(len(points)):
        order[starts[cell[i] + 1]] = i
        starts[cell[i] + 1] += 1


# --- the compiled search ---------------------------------------------------------------------------------
#
# The points are grouped by the cells of a grid. Around the cell of a place, a block of 3³ cells is searched,
# of 5³, and so on, until it has k points that are nearer than its border, so that no point outside can be
# nearer. All lengths are in cells, so that their squares do not underflow.
#
# Points are sorted by keys: the squares of distances, whose last bits are the number of the point. Keys wait
# in a list and are exchanged without branches, of which many would be mispredicted.

Place = tuple[float, float, float]


@compiled(error_model="numpy")
def _nearest(
    points: FloatArray,
    places: FloatArray,
    grouped: FloatArray,
    scaled: FloatArray,
    shape: Shape,
    order: Order,
    starts: Order,
    found: tuple[FloatArray, Index],
) -> None:
    """Set the distances and numbers (m, k) of the points that are nearest to each place, the nearest first.

    grouped, scaled: the points, in their order, and the places, in cells.
    """
    distance, near = found
    low_bits = (1 << int(np.ceil(np.log2(len(points) + 1)))) - 1
    keys, waiting = np.empty(near.shape[1]), np.empty(len(points) + 1)
    numbers = keys.view(np.int64)
    for q in range(len(places)):
        place = scaled[q, 0], scaled[q, 1], scaled[q, 2]
        _search(grouped, starts, shape, place, low_bits, waiting, keys)
        exact = places[q, 0], places[q, 1], places[q, 2]
        for j in range(len(keys)):
            near[q, j] = order[numbers[j] & low_bits]
            distance[q, j] = np.sqrt(_square(points, near[q, j], exact))


@inlined(error_model="numpy")
def _search(
    grouped: FloatArray,
    starts: Order,
    shape: Shape,
    place: Place,
    low_bits: int,
    waiting: FloatArray,
    keys: FloatArray,
) -> None:
    """Fill the keys of the points nearest to a place, ascending."""
    n, ring = 0, 0
    while n < len(keys):
        ring += 1
        gap = _to_border(place, shape, ring)
        limit = (1 - ROUNDING) * gap * gap
        n_waiting = _collect(
            grouped, starts, shape, place, ring, limit, low_bits, waiting
        )
        n = _insert(keys, waiting, n_waiting)


@inner(error_model="numpy")
def _to_border(place: Place, shape: Shape, ring: int) -> float:
    """The distance from a place to the border of its block, beyond which there are more cells."""
    gap = np.inf
    for axis in range(3):
        cell = _cell(place[axis], shape[axis])
        if cell - ring > 0:
            gap = min(gap, place[axis] - (cell - ring))
        if cell + ring + 1 < shape[axis]:
            gap = min(gap, cell + ring + 1 - place[axis])
    return gap


@inner(error_model="numpy")
def _block(place: float, n: int, ring: int) -> tuple[int, int]:
    """The first cell of a block along one axis, and the one after the last."""
    cell = _cell(place, n)
    return max(0, cell - ring), min(n, cell + ring + 1)


@inlined(error_model="numpy")
def _collect(
    grouped: FloatArray,
    starts: Order,
    shape: Shape,
    place: Place,
    ring: int,
    limit: float,
    low_bits: int,
    waiting: FloatArray,
) -> int:
    """Write the keys of the points of a block within a squared distance; returns their number."""
    n = 0
    x = _block(place[0], shape[0], ring)
    y = _block(place[1], shape[1], ring)
    z = _block(place[2], shape[2], ring)
    for u in range(x[0], x[1]):
        for v in range(y[0], y[1]):
            line = (u * shape[1] + v) * shape[2]
            # The points in the cells of one line follow each other.
            for i in range(starts[line + z[0]], starts[line + z[1]]):
                square = max(_square(grouped, i, place), TINY)
                bits = np.float64(square).view(np.int64) & ~low_bits | i
                waiting[n] = np.int64(bits).view(np.float64)
                n += square <= limit
    return n


@inlined(error_model="numpy")
def _insert(keys: FloatArray, waiting: FloatArray, n_waiting: int) -> int:
    """Sort the smallest of the waiting keys into an empty list; returns how many there are."""
    n = 0
    for i in range(n_waiting):
        key = waiting[i]
        for j in range(n):
            keys[j], key = min(keys[j], key), max(keys[j], key)
        if n < len(keys):
            keys[n] = key
            n += 1
    return n


@inner(error_model="numpy")
def _square(points: FloatArray, i: int, place: Place) -> float:
    """The square of the distance of a point from a place."""
    x, y, z = points[i, 0] - place[0], points[i, 1] - place[1], points[i, 2] - place[2]
    return float(x * x + y * y + z * z)


# Smallest cosine of the angle between normals, or guide directions, of points on one side of a thin part.
SAME_SIDE = 0.2

# Width of the Gaussian weight of neighbours, relative to the distance of the farthest one.
NEIGHBOR_SPREAD = 0.7

# Smallest length of the cross product of two rows of A − λI, relative to the squared size of A, by which the
# eigenvector of λ is determined. Below it λ is a multiple eigenvalue up to rounding errors.
LEAST_RANK = 1e-12

# Added to a vector that may be zero, where any direction is right.
NOTHING = 1e-30

# A symmetric matrix: xx, yy, zz, xy, xz, yz.
Symmetric = tuple[float, float, float, float, float, float]


@compiled()
def plane_deviations(points: FloatArray, near: NDArray[np.intp]) -> FloatArray:
    """(m,) root mean square distances of (m, k) neighbours from their least-squares planes.

    They are √(Σ d² / (k − 3)), since a plane has three degrees of freedom; with k ≤ 4, √(Σ d²).
    """
    n, k = near.shape
    weight = np.ones(k)
    found = np.empty(n)
    for i in range(n):
        # Σ d² is the smallest eigenvalue, which rounding can make negative.
        squares = _smallest_eigenvalue(_covariance(points, near[i], weight))
        found[i] = np.sqrt(max(squares, 0.0) / max(1, k - 3))
    return found


@compiled(error_model="numpy")
def guided_planes(
    points: FloatArray,
    guide: FloatArray,
    near: NDArray[np.intp],
    distance: FloatArray,
) -> FloatArray:
    """(n, 3) unit normals of weighted least-squares planes, with the orientation of a guide.

    The weight of a neighbour is the product of a Gaussian of its distance and of the excess of the cosine
    between its guide and that of the point over a limit.

    guide: (n, 3) float64, approximate unit direction to the outside at each point; zero if unknown.
    near, distance: (n, k), the neighbours of each point, the nearest first.
    """
    weight = np.empty(near.shape[1])
    normals = np.empty((len(near), 3))
    for i in range(len(near)):
        _weigh(weight, guide, i, near[i], distance[i])
        x, y, z = _smallest_eigenvector(_covariance(points, near[i], weight))
        sign = -1.0 if x * guide[i, 0] + y * guide[i, 1] + z * guide[i, 2] < 0 else 1.0
        normals[i, 0], normals[i, 1], normals[i, 2] = sign * x, sign * y, sign * z
    return normals


@inner(error_model="numpy")
def _weigh(
    weight: FloatArray,
    guide: FloatArray,
    i: int,
    near: NDArray[np.intp],
    distance: FloatArray,
) -> None:
    """Set the weights (k,) of the neighbours of point i, as for `guided_planes`."""
    x, y, z = guide[i, 0], guide[i, 1], guide[i, 2]
    is_known = x != 0 or y != 0 or z != 0
    width = NEIGHBOR_SPREAD * distance[-1] + TINY
    for j in range(len(near)):
        other = near[j]
        cosine = x * guide[other, 0] + y * guide[other, 1] + z * guide[other, 2]
        excess = (cosine - SAME_SIDE) / (1 - SAME_SIDE)
        weight[j] = min(max(excess, 0.0), 1.0) if is_known else 1.0
        weight[j] *= np.exp(-((distance[j] / width) ** 2))


@inner(error_model="numpy")
def _covariance(
    points: FloatArray, near: NDArray[np.intp], weight: FloatArray
) -> Symmetric:
    """Σ w (p − m)(p − m)ᵀ of points with the weighted mean m."""
    total = x = y = z = 0.0
    for j in range(len(near)):
        w, p = weight[j], near[j]
        total += w
        x += w * points[p, 0]
        y += w * points[p, 1]
        z += w * points[p, 2]
    x, y, z = x / total, y / total, z / total
    xx = yy = zz = xy = xz = yz = 0.0
    for j in range(len(near)):
        w, p = weight[j], near[j]
        a, b, c = points[p, 0] - x, points[p, 1] - y, points[p, 2] - z
        xx += w * a * a
        yy += w * b * b
        zz += w * c * c
        xy += w * a * b
        xz += w * a * c
        yz += w * b * c
    return xx, yy, zz, xy, xz, yz


@inner(error_model="numpy")
def _smallest_eigenvalue(matrix: Symmetric) -> float:
    # The trigonometric solution of the characteristic polynomial of a symmetric matrix (Smith, "Eigenvalues
    # of a symmetric 3 × 3 matrix", Communications of the ACM 4, 1961).
    xx, yy, zz, xy, xz, yz = matrix
    mean = (xx + yy + zz) / 3
    a, b, c = xx - mean, yy - mean, zz - mean
    size = np.sqrt((a * a + b * b + c * c + 2 * (xy * xy + xz * xz + yz * yz)) / 6)
    if size == 0:
        return mean
    determinant = (
        a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)
    )
    half = min(max(determinant / (2 * size**3), -1.0), 1.0)
    return float(mean + 2 * size * np.cos((np.arccos(half) + 2 * np.pi) / 3))


@inner(error_model="numpy")
def _smallest_eigenvector(matrix: Symmetric) -> Place:
    """A unit eigenvector of the smallest eigenvalue λ of A."""
    scaled = _scaled(matrix)
    value = _smallest_eigenvalue(scaled)
    xx, yy, zz, xy, xz, yz = scaled
    a, b, c, trace = xx - value, yy - value, zz - value, xx + yy + zz
    # A vector that is perpendicular to all rows of A − λI is the cross product of two of them.
    axis, length = _longest(
        (xy * yz - xz * b, xz * xy - a * yz, a * b - xy * xy),
        (xy * c - xz * yz, xz * xz - a * c, a * yz - xy * xz),
        (b * c - yz * yz, yz * xz - xy * c, xy * yz - b * xz),
    )
    if not length > LEAST_RANK * trace * trace:
        # A − λI has one eigenvalue μ beside zeros, and μI − (A − λI) has eigenvectors of λ as its rows.
        axis, length = _longest(
            (b + c + NOTHING, -xy, -xz), (-xy, a + c, -yz), (-xz, -yz, a + b)
        )
    return axis[0] / length, axis[1] / length, axis[2] / length


@inner(error_model="numpy")
def _scaled(matrix: Symmetric) -> Symmetric:
    """A times a power of two, so that its digits stay, and squares of entries do not underflow.

    They would for points that nearly coincide.
    """
    _, exponent = math.frexp(matrix[0] + matrix[1] + matrix[2])
    unit = math.ldexp(1.0, -max(exponent, -1000))
    xx, yy, zz, xy, xz, yz = matrix
    return unit * xx, unit * yy, unit * zz, unit * xy, unit * xz, unit * yz


@inner(error_model="numpy")
def _longest(first: Place, second: Place, third: Place) -> tuple[Place, float]:
    """The longest of three vectors, and its length."""
    best, longest = first, -1.0
    for vector in (first, second, third):
        square = vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2
        if square > longest:
            best, longest = vector, square
    return best, np.sqrt(longest)


# Number of neighbours for the spacing and for a plane, and number of points at which both are measured.
SPACING_NEIGHBORS = 6
PLANE_NEIGHBORS = 8
MEASURED = 5000

# Quantile of the distances from the planes. Curvature increases these distances, so that a low quantile is a
# better estimate of the noise than the median.
FLATTEST = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class Neighborhoods:
    """The (m, k) nearest neighbours of points of a cloud, of which the first is the point itself."""

    distance: FloatArray
    near: NDArray[np.intp]

    def some(self) -> Neighborhoods:
        """The neighbourhoods of about `MEASURED` of the points, at regular steps; a copy."""
        step = max(1, len(self.near) // MEASURED)
        return Neighborhoods(self.distance[::step].copy(), self.near[::step].copy())


def neighborhoods(points: FloatArray, k: int, *, of_some: bool = False) -> Neighborhoods:
    """The nearest neighbours of all points among themselves, or of some of them."""
    places = (
        np.ascontiguousarray(points[:: max(1, len(points) // MEASURED)])
        if of_some
        else points
    )
    return Neighborhoods(*nearest(points, places, min(k, len(points))))


def plane_neighborhoods(points: FloatArray, options: ScanOptions) -> Neighborhoods:
    """The neighbours that normals and all later stages need."""
    return neighborhoods(points, max(options.normal_neighbors, PLANE_NEIGHBORS + 1))


def among(
    points: FloatArray, is_kept: NDArray[np.bool_], neighbors: Neighborhoods, k: int
) -> Neighborhoods:
    """The k nearest neighbours of the kept points, (m, 3), among themselves, from those of all points."""
    k = min(k, len(points))
    distance, near = neighbors.distance[is_kept, :k], neighbors.near[is_kept, :k]
    short = np.flatnonzero(~is_kept[near].all(axis=1))
    near = (np.cumsum(is_kept) - 1)[near]
    distance[short], near[short] = nearest(points, points[short], k)
    return Neighborhoods(distance, near)


def spacing(neighbors: Neighborhoods) -> float:
    """The spacing of points: the square root of the area of surface for each point, in the median.

    It is estimated from the circle that contains the `SPACING_NEIGHBORS` nearest neighbours, so that it is
    the same for a regular and a random sampling of one density.
    """
    k = min(SPACING_NEIGHBORS, neighbors.distance.shape[1] - 1)
    return float(np.sqrt(np.pi / k) * np.median(neighbors.distance[:, k]))


def noise(points: FloatArray, neighbors: Neighborhoods) -> float:
    """The noise of points: their root mean square distance from the plane of their neighbours.

    It is about 0.8 of the standard deviation of each coordinate, if the noise is isotropic.
    """
    near = np.ascontiguousarray(neighbors.near[:, : PLANE_NEIGHBORS + 1])
    return float(
        np.quantile(
            plane_deviations(np.broadcast_to(points, points.shape), near), FLATTEST
        )
    )


def voxel_numbers(points: FloatArray, edge: float) -> NDArray[np.int64]:
    """(n,) number of the voxel of each point, ascending by the first, the second and the third coordinate."""
    number = np.zeros(len(points), dtype=np.int64)
    for column in points.T:  # one after the other, in a third of the memory
        index = np.floor((column - column.min()) / edge).astype(np.int64)
        number = number * (index.max() + 1) + index
    return number
