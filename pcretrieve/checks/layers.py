"""Layers of points along one surface, which views leave that were registered badly.

Around some places, the heights of the points above a fitted surface are sorted. Noise spreads the heights,
and layers bunch them: the steps from one to the next are then small, compared with the width of all.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.points.neighbors import nearest
from pcretrieve.values import FloatArray, PointCloud, tangent_axes

# Number of points that are compared, so that a neighbourhood is wider than layers are apart.
COMPARED = 10_000

# Number of places at which they are compared.
PLACES = 1500

# Number of points around a place, and the smallest fraction of them that is on the same side of the body.
AROUND = 40
LEAST_AROUND = 0.6

# A height is compared with the third next one, since single spacings vary too much.
NEXT = 3

# Smallest difference of such two heights, relative to the diagonal. Sensors measure in steps, and layers that
# are so near to each other do no harm.
LEAST_STEP = 7.5e-5

# Number of places over which the entropy is averaged, because that of one place is uncertain.
POOLED = 20

# Entropy that layers lack, compared with a normal distribution as wide. Where noise is a hundredth of the
# diagonal or less, it lacks so much at 3 % of the places at most.
BUNCHED = 0.28

# Smallest width of layers, relative to the diagonal: 5 mm of a person.
LEAST_WIDTH = 0.0025

# Quantiles between which the width is measured, and the entropy of a normal distribution if that is 1.
LOW = 0.1
HIGH = 0.9
NORMAL = 0.478


class Layers(NamedTuple):
    """Where points lie in several layers along one surface.

    places: (m, 3) float64, some points of the cloud, all over the body.
    apart: (m,) float64, distance of the outermost layers there, unit of the cloud; 0 if there is one.
    """

    places: FloatArray
    apart: FloatArray


def double_layers(cloud: PointCloud) -> Layers:
    """Find the places where the points of a filtered cloud with normals lie in several layers.

    The entropy of the heights is estimated from their spacings [1]_. Points on the other side of a thin part
    are left out, by their normals.

    References
    ----------
    .. [1] O. Vasicek, "A test for normality based on sample entropy", Journal of the Royal Statistical
       Society B 38 (1976).
    """
    step = max(1, round(len(cloud.points) / COMPARED))
    points = np.ascontiguousarray(cloud.points[::step])
    normals = np.ascontiguousarray(np.asarray(cloud.normals)[::step])
    step = max(1, len(points) // PLACES)
    places, facing = np.ascontiguousarray(points[::step]), normals[::step]
    _, near = nearest(points, places, min(AROUND, len(points)))
    # Rows are taken four times as fast as by an index in brackets.
    is_same = np.einsum("mi,mki->mk", facing, normals.take(near, axis=0)) > 0
    offsets = (points.take(near, axis=0) - places[:, np.newaxis]) / cloud.diagonal
    lacking, width = _bunching(offsets, facing, is_same)
    lacking[is_same.mean(axis=1) < LEAST_AROUND] = 0
    _, pooled = nearest(places, places, min(POOLED, len(places)))
    means = np.mean([lacking[pooled], width[pooled]], axis=2)
    is_layered = (means[0] > BUNCHED) & (means[1] > LEAST_WIDTH)
    return Layers(places, np.where(is_layered, cloud.diagonal * width, 0))


def _bunching(
    offsets: FloatArray, normals: FloatArray, is_same: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray]:
    """The entropy that heights lack, compared with a normal distribution as wide; and their width, (m,).

    offsets: (m, k, 3) float64, of points from the places that have the normals, relative to the diagonal.
    is_same: (m, k) bool, the points that count.
    """
    frames = np.stack([normals, *tangent_axes(normals)], axis=1)  # (m, 3, 3)
    z, x, y = (frames @ offsets.swapaxes(1, 2)).swapaxes(0, 1)  # (m, k) each
    # The heights above a quadratic surface that is fitted to the points. Points on a line determine none: a
    # term of the size of rounding errors decides for one.
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=2)  # (m, k, 6)
    weighted = (terms * is_same[:, :, np.newaxis]).swapaxes(1, 2)
    matrix = weighted @ terms + np.finfo(np.float64).eps * np.eye(6)
    fitted = terms @ np.linalg.solve(matrix, weighted @ z[:, :, np.newaxis])
    heights = np.sort(np.where(is_same, z - fitted[:, :, 0], np.nan), axis=1)  # NaN last
    n = is_same.sum(axis=1)
    ranks = np.rint(np.outer([LOW, HIGH], n - 1)).astype(int)  # (2, m)
    low, high = heights[np.arange(len(n)), ranks]
    width = np.maximum(high - low, LEAST_STEP)
    steps = np.maximum(heights[:, NEXT:] - heights[:, :-NEXT], LEAST_STEP)
    entropy = np.nansum(np.log(steps), axis=1) / np.maximum(n - NEXT, 1) + np.log(
        (n + 1) / NEXT
    )
    return np.log(width) + NORMAL - entropy, width
