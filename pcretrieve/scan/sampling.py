"""The density and the noise of the points of a scan."""

from __future__ import annotations

import numpy as np

from pcretrieve.types import FloatArray

__all__ = ["noise", "spacing"]

# Number of neighbours for the spacing, number of neighbours for a plane, and number
# of points at which both are measured.
COMPANY = 6
IN_PLANE = 8
MEASURED = 5000

# Quantile of the distances from the planes. Curvature increases these distances, so that a low quantile is a
# better estimate of the noise than the median.
FLATTEST = 0.25


def spacing(points: FloatArray) -> float:
    """The spacing of points: the square root of the area of surface for each point, in the median.

    It is estimated from the circle that contains the `COMPANY` nearest neighbours, so that it is the same for
    a regular and a random sampling of one density.

    Parameters
    ----------
    points : (n, 3) float64
        At least two points.

    Returns
    -------
    float
        Unit of the file.
    """
    from scipy.spatial import cKDTree

    k = min(COMPANY, len(points) - 1)
    distance, _ = cKDTree(points).query(_some(points), k=[k + 1])
    return float(np.sqrt(np.pi / k) * np.median(distance))


def noise(points: FloatArray) -> float:
    """The noise of points: their root mean square distance from the plane of their neighbours.

    It is about 0.8 of the standard deviation of each coordinate, if the noise is isotropic.

    Parameters
    ----------
    points : (n, 3) float64
        At least two points.

    Returns
    -------
    float
        Unit of the file.
    """
    from scipy.spatial import cKDTree

    k = min(IN_PLANE + 1, len(points))
    _, near = cKDTree(points).query(_some(points), k=k)
    offsets = points[near] - points[near].mean(axis=1, keepdims=True)  # (m, k, 3)
    # A plane has three degrees of freedom, so that k points leave k − 3.
    from_plane = np.linalg.svd(offsets, compute_uv=False)[:, 2] / np.sqrt(max(1, k - 3))  # (m,)
    return float(np.quantile(from_plane, FLATTEST))


def _some(points: FloatArray) -> FloatArray:
    return points[:: max(1, len(points) // MEASURED)]
