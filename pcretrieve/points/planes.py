"""Least-squares planes of neighbourhoods, compiled by numba."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pcretrieve.values import FloatArray

__all__ = ["guided_planes", "plane_deviations"]

# Smallest length of the cross product of two rows of A − λI, relative to the squared size of A, by which the
# eigenvector of λ is determined. Below it λ is a multiple eigenvalue up to rounding errors.
LEAST_RANK = 1e-12

# A symmetric matrix: xx, yy, zz, xy, xz, yz.
Symmetric = tuple[float, float, float, float, float, float]


@njit(cache=True)
def plane_deviations(points: FloatArray, near: NDArray[np.intp]) -> FloatArray:
    """Root mean square distances of neighbours from their least-squares planes.

    points: (n, 3) float64, coordinates.
    near: (m, k) int, numbers of the neighbours of m points.
    Returns (m,) float64: √(Σ d² / (k − 3)), since a plane has three degrees of freedom; with k ≤ 4, √(Σ d²).
        Unit of the points.
    """
    n, k = near.shape
    weight = np.ones(k)
    found = np.empty(n)
    for i in range(n):
        x, y, z = _smallest_eigenvector(_covariance(points, near[i], weight))
        # The smallest eigenvalue is Σ d² too, but its root would have half as many digits.
        total, squares = 0.0, 0.0
        for j in range(k):
            total += x * points[near[i, j], 0] + y * points[near[i, j], 1] + z * points[near[i, j], 2]
        for j in range(k):
            p = near[i, j]
            squares += (x * points[p, 0] + y * points[p, 1] + z * points[p, 2] - total / k) ** 2
        found[i] = np.sqrt(squares / max(1, k - 3))
    return found


@njit(cache=True, error_model="numpy")
def guided_planes(
    points: FloatArray,
    guide: FloatArray,
    near: NDArray[np.intp],
    distance: FloatArray,
    same_side: float,
    spread: float,
) -> FloatArray:
    """Normals of weighted least-squares planes, with the orientation of a guide.

    The weight of a neighbour is the product of a Gaussian of its distance and of the excess of the cosine
    between its guide and that of the point over a limit.

    points: (n, 3) float64, coordinates.
    guide: (n, 3) float64, approximate unit direction to the outside at each point; zero if unknown.
    near: (n, k) int, numbers of the neighbours of each point, the nearest first.
    distance: (n, k) float64, their distances; unit of the points.
    Returns (n, 3) float64: unit normals.
    """
    n, k = near.shape
    weight = np.empty(k)
    normals = np.empty((n, 3))
    for i in range(n):
        a, b, c = guide[i, 0], guide[i, 1], guide[i, 2]
        is_known = a != 0 or b != 0 or c != 0
        width = spread * distance[i, k - 1] + np.finfo(np.float64).tiny
        for j in range(k):
            other = near[i, j]
            cosine = a * guide[other, 0] + b * guide[other, 1] + c * guide[other, 2]
            weight[j] = min(max((cosine - same_side) / (1 - same_side), 0.0), 1.0) if is_known else 1.0
            weight[j] *= np.exp(-((distance[i, j] / width) ** 2))
        x, y, z = _smallest_eigenvector(_covariance(points, near[i], weight))
        sign = -1.0 if x * a + y * b + z * c < 0 else 1.0
        normals[i, 0], normals[i, 1], normals[i, 2] = sign * x, sign * y, sign * z
    return normals


@njit(cache=True, error_model="numpy")
def _covariance(points: FloatArray, near: NDArray[np.intp], weight: FloatArray) -> Symmetric:
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


@njit(cache=True, error_model="numpy")
def _smallest_eigenvalue(matrix: Symmetric) -> float:
    # The trigonometric solution of the characteristic polynomial of a symmetric matrix (Smith, "Eigenvalues
    # of a symmetric 3 × 3 matrix", Communications of the ACM 4, 1961).
    xx, yy, zz, xy, xz, yz = matrix
    mean = (xx + yy + zz) / 3
    a, b, c = xx - mean, yy - mean, zz - mean
    size = np.sqrt((a * a + b * b + c * c + 2 * (xy * xy + xz * xz + yz * yz)) / 6)
    if size == 0:
        return mean
    determinant = a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)
    half = min(max(determinant / (2 * size**3), -1.0), 1.0)
    return float(mean + 2 * size * np.cos((np.arccos(half) + 2 * np.pi) / 3))


@njit(cache=True, error_model="numpy")
def _smallest_eigenvector(matrix: Symmetric) -> tuple[float, float, float]:
    """A unit eigenvector of the smallest eigenvalue λ of A."""
    # A power of two, so that the scaled matrix has the same digits; squares of the entries do not underflow
    # then, as they would for points that nearly coincide.
    _, exponent = math.frexp(matrix[0] + matrix[1] + matrix[2])
    xx, yy, zz = (
        math.ldexp(matrix[0], -exponent),
        math.ldexp(matrix[1], -exponent),
        math.ldexp(matrix[2], -exponent),
    )
    xy, xz, yz = (
        math.ldexp(matrix[3], -exponent),
        math.ldexp(matrix[4], -exponent),
        math.ldexp(matrix[5], -exponent),
    )
    value = _smallest_eigenvalue((xx, yy, zz, xy, xz, yz))
    a, b, c = xx - value, yy - value, zz - value
    # It is perpendicular to all rows of A − λI: of the cross products of two rows, the longest is taken.
    first = (xy * yz - xz * b, xz * xy - a * yz, a * b - xy * xy)
    second = (xy * c - xz * yz, xz * xz - a * c, a * yz - xy * xz)
    third = (b * c - yz * yz, yz * xz - xy * c, xy * yz - b * xz)
    best, longest = first, -1.0
    for vector in (first, second, third):
        square = vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2
        if square > longest:
            best, longest = vector, square
    length = np.sqrt(longest)
    trace = xx + yy + zz
    if length > LEAST_RANK * trace * trace:
        return best[0] / length, best[1] / length, best[2] / length
    full = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    axis = np.linalg.eigh(full)[1][:, 0]
    return axis[0], axis[1], axis[2]
