"""Features of points by Open3D, as functions of arrays."""

from __future__ import annotations

import numpy as np

from pcretrieve.adapters.frame import DOUBLE_OFFSET, Frame
from pcretrieve.adapters.open3d import library, open3d_cloud
from pcretrieve.arrays import FloatArray

__all__ = ["feature_histograms"]


def feature_histograms(points: FloatArray, normals: FloatArray, *, radius: float) -> FloatArray:
    """Fast point feature histograms (FPFH) [1]_, invariant to rigid motion.

    points, normals: (n, 3) float64, coordinates and unit normals.
    radius: radius of the neighbourhood of a point; unit of the points.
    Returns (n, 33) float64: histograms of the angles between the normals in the neighbourhood of each point.

    References
    ----------
    .. [1] Rusu et al., "Fast point feature histograms (FPFH) for 3D registration", ICRA 2009.
    """
    o3d = library()
    frame = Frame.around(points, offset=DOUBLE_OFFSET)
    search = o3d.geometry.KDTreeSearchParamRadius(radius / frame.size)
    features = o3d.pipelines.registration.compute_fpfh_feature(
        open3d_cloud(frame.inward(points), normals), search
    )
    return np.array(features.data.T)  # (n, 33)
