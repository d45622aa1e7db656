"""The axes of a camera in front of a body that stands upright."""

from __future__ import annotations

import numpy as np

from pcretrieve.arrays import UPWARD, FloatArray, IntArray
from pcretrieve.errors import OptionError

# Tie-breaker for shapes whose principal axes are not unique, such as a sphere: a bias towards the axes of the
# file. As a fraction of the total variance, and as a skewness, it is far above rounding errors and not
# visible.
TIE = 1e-6

# Factor of the odd moments of the axis of least variance when the axis from left to right is looked for,
# because thin bodies are nearly symmetric from front to back. Of 1, 1.25, 1.5, 2 and 3, this one lets the
# most bodies of TOSCA stand.
THINNEST = 1.25

# Largest angle between an axis and the direction upwards of a body that stands along it.
NEAR_AXIS = np.radians(30)

# Least number of bodies that show along which axis all bodies of their collection stand.
FEWEST_BODIES = 10


def upward(axis: str | None) -> FloatArray | None:
    """(3,) the direction of an axis of a file, such as ``-y``; None for None."""
    if axis is None:
        return None
    if axis not in UPWARD:
        raise OptionError(f"up must be one of {', '.join(UPWARD)}, got {axis!r}")
    direction = np.zeros(3)
    direction["xyz".index(axis[-1])] = -1 if axis[0] == "-" else 1
    return direction


def common_axis(directions: FloatArray) -> FloatArray | None:
    """The axis of files along which bodies stand, if the directions that were found for them show one.

    Directions are wrong for some bodies, but not all along one axis. Of 76 bodies of TOSCA, whose files have
    the z axis upwards, 40 are found to stand along it, and at most 7 along each other one.

    directions: (n, 3), the direction upwards of each body, of length 1.
    Returns (3,) or None: an axis along which at least 4 of 10 bodies stand, and three times as many as along
        each other one.
    """
    axes = np.stack([direction for name in UPWARD if (direction := upward(name)) is not None])
    along = (directions.reshape(-1, 3) @ axes.T > np.cos(NEAR_AXIS)).sum(axis=0)
    second, first = np.sort(along)[-2:]
    if len(directions) < FEWEST_BODIES or first < 0.4 * len(directions) or first < 3 * second:
        return None
    return np.asarray(axes[along.argmax()])


def body_axes(vertices: FloatArray, faces: IntArray, up: FloatArray | None = None) -> FloatArray:
    """(3, 3) the axes of a camera in front of a surface of positive area, as from `principal_axes`."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2  # (m,)
    # The midpoints of the edges, each with a third of the area, integrate quadratics over a triangle exactly.
    points = np.concatenate([(c + a) / 2, (a + b) / 2, (b + c) / 2])  # (3m, 3)
    return principal_axes(points, np.tile(areas, 3) / (3 * areas.sum()), up)


def principal_axes(points: FloatArray, weights: FloatArray, up: FloatArray | None = None) -> FloatArray:
    """The axes of a camera in front of a body, by the principal axes of weighted points.

    The direction of view is the axis of least variance, of those that are perpendicular to up. If up is not
    given, it is one of the other two principal axes, against its skewness, so that a body with a head and
    legs stands on its legs. It is not the axis with the smallest odd moments, which is that from left to
    right: people stand, and arms that are stretched to the sides are level. If that axis is the direction of
    view, as of an animal with four legs, up is the more skewed of the other two.

    weights: (n,), with the sum 1.
    up: (3,), of length 1.
    Returns (3, 3): orthonormal, right-handed rows: the directions to the right, upwards, and towards the
        camera; as near as possible to the axes x, y and z where the principal axes are not unique.
    """
    points = points - weights @ points
    variance = weights @ (points**2).sum(axis=1)
    points = points / np.sqrt(variance if variance > 0 else 1.0)  # total variance 1
    covariance = (weights[:, np.newaxis] * points).T @ points + TIE * np.diag([1.0, 2.0, 0.0])  # (3, 3)
    if up is None:
        axes: FloatArray = np.linalg.eigh(covariance)[1].T
        towards, up = axes[0], _upwards(points, weights, axes)
    else:
        level = np.eye(3) - np.outer(up, up)
        # The axis up gets more than the total variance, so that the first axis is perpendicular to it.
        towards = np.linalg.eigh(level @ covariance @ level + 2 * np.outer(up, up))[1][:, 0]
    right = np.cross(up, towards)
    sides = (
        _skewness(points, weights, right) + TIE * right[0],
        _skewness(points, weights, towards) + TIE * towards[2],
    )
    if max(sides, key=abs) < 0:
        right, towards = -right, -towards
    return np.stack([right, up, towards])


def _upwards(points: FloatArray, weights: FloatArray, axes: FloatArray) -> FloatArray:
    """(3,) the direction upwards; the rows of `axes` are the principal axes, that of least variance first."""
    middle, longest = axes[1:]
    odd = _odd_moments(points, weights, axes)
    symmetric = int(np.argmin([THINNEST * odd[0], odd[1] + TIE, odd[2] + TIE]))
    if symmetric == 0:
        skewed = [abs(_skewness(points, weights, axis)) for axis in (middle, longest)]
        symmetric = 1 if skewed[1] + TIE >= skewed[0] else 2
    up = longest if symmetric == 1 else middle
    upwards: FloatArray = -up if _skewness(points, weights, up) > TIE * up[1] else up
    return upwards


def _skewness(points: FloatArray, weights: FloatArray, axis: FloatArray) -> float:
    along = points @ axis
    squares = along * along
    return float(weights @ (squares * along) / np.maximum(weights @ squares, TIE) ** 1.5)


def _odd_moments(points: FloatArray, weights: FloatArray, axes: FloatArray) -> FloatArray:
    """(3,) norm of the third moments that change their sign with each axis; 0 for a mirror axis."""
    along = points @ axes.T  # (n, 3)
    along /= np.sqrt(np.maximum(weights @ along**2, TIE))
    products = (along[:, :, np.newaxis] * along[:, np.newaxis]).reshape(-1, 9)
    third = ((weights[:, np.newaxis] * along).T @ products).reshape(3, 3, 3)
    times = [(np.indices(third.shape) == axis).sum(axis=0) for axis in range(3)]
    return np.array([np.linalg.norm(third[number % 2 == 1]) for number in times])
