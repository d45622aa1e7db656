"""How densely and how exactly points sample a surface."""

from __future__ import annotations

import numpy as np

from pcretrieve.types import FloatArray

__all__ = ["noise", "spacing"]

# Neighbours that the spacing is measured by, those that a plane is fitted to, and points that both are
# measured at.
COMPANY = 6
IN_PLANE = 8
MEASURED = 5000

# Where surfaces curve, points leave their plane without any noise: the flattest quarter is believed.
FLATTEST = 0.25


def spacing(points: FloatArray) -> float:
    """Side of the square of surface that each point stands for, of the median point; unit of the file.

    Measured by the circle that holds the `COMPANY` nearest neighbours, so that a regular and a random
    sampling of the same density give the same.
    """
    from scipy.spatial import cKDTree

    k = min(COMPANY, len(points) - 1)
    distance, _ = cKDTree(points).query(_some(points), k=[k + 1])
    return float(np.sqrt(np.pi / k) * np.median(distance))


def noise(points: FloatArray) -> float:
    """Distance of points from the plane of their neighbours, in the root mean square; unit of the file.

    About .8 of the standard deviation of each coordinate where points are scattered in all directions.
    """
    from scipy.spatial import cKDTree

    k = min(IN_PLANE + 1, len(points))
    _, near = cKDTree(points).query(_some(points), k=k)
    offsets = points[near] - points[near].mean(axis=1, keepdims=True)  # (m, k, 3)
    # A plane takes three degrees of freedom from k points.
    from_plane = np.linalg.svd(offsets, compute_uv=False)[:, 2] / np.sqrt(max(1, k - 3))  # (m,)
    return float(np.quantile(from_plane, FLATTEST))


def _some(points: FloatArray) -> FloatArray:
    return points[:: max(1, len(points) // MEASURED)]
