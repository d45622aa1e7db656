"""The neighbours of points, and the density and the noise of a scan, which are measured by neighbours.

The search for neighbours takes longer than the measurements. A stage therefore searches once, and passes the
result to all functions that need neighbours. See docs/decisions.md, neighborhoods.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pcretrieve.points.nearest import nearest
from pcretrieve.points.planes import plane_deviations
from pcretrieve.values import FloatArray

__all__ = [
    "PLANE_NEIGHBORS",
    "SPACING_NEIGHBORS",
    "Neighborhoods",
    "neighborhoods",
    "noise",
    "spacing",
    "voxel_numbers",
]

# Number of neighbours for the spacing, number of neighbours for a plane, and number of points at which both
# are measured.
SPACING_NEIGHBORS = 6
PLANE_NEIGHBORS = 8
MEASURED = 5000

# Quantile of the distances from the planes. Curvature increases these distances, so that a low quantile is a
# better estimate of the noise than the median.
FLATTEST = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class Neighborhoods:
    """The nearest neighbours of m points of a cloud.

    distance: (m, k) float64, distances from the point, ascending; the first is that of the point itself,
        zero. Unit of the file.
    near: (m, k) int, numbers of the neighbours in the cloud.
    """

    distance: FloatArray
    near: NDArray[np.intp]

    def some(self) -> Neighborhoods:
        """The neighbourhoods of about `MEASURED` of the points, at regular steps."""
        step = _step(len(self.near))
        return Neighborhoods(self.distance[::step], self.near[::step])


def neighborhoods(points: FloatArray, k: int, *, of_some: bool = False) -> Neighborhoods:
    """Search for the nearest neighbours of points among themselves.

    points: (n, 3) float64, at least two points.
    Returns Neighborhoods: of all points, or of some; unit of the file.
    """
    asked = np.ascontiguousarray(points[:: _step(len(points))]) if of_some else points
    return Neighborhoods(*nearest(points, asked, min(k, len(points))))


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

    points: (n, 3) float64, coordinates.
    """
    near = np.ascontiguousarray(neighbors.near[:, : PLANE_NEIGHBORS + 1])
    deviations = plane_deviations(points, near)
    return float(np.quantile(deviations, FLATTEST))


def voxel_numbers(points: FloatArray, edge: float) -> NDArray[np.int64]:
    """The number of the voxel that contains each point.

    points: (n, 3) float64, at least one point.
    edge: edge of the voxels; unit of the points.
    Returns (n,) int64: equal for points in one voxel; ascending by the first, the second and the third
        coordinate.
    """
    index = np.floor((points - points.min(axis=0)) / edge).astype(np.int64)  # (n, 3)
    sides = index.max(axis=0) + 1
    number: NDArray[np.int64] = (index[:, 0] * sides[1] + index[:, 1]) * sides[2] + index[:, 2]
    return number


def _step(n: int) -> int:
    return max(1, n // MEASURED)
