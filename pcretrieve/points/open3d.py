"""Normals and features of points by Open3D, as functions of arrays."""

from __future__ import annotations

import numpy as np

from pcretrieve.arrays import DOUBLE_OFFSET, Frame
from pcretrieve.draw.open3d import library, open3d_cloud
from pcretrieve.errors import ReconstructionError, Stage
from pcretrieve.values import FloatArray


def estimate_normals(points: FloatArray, *, n_neighbors: int) -> FloatArray:
    """Normals of the least-squares planes of the neighbours of each point.

    points: (n, 3) float64, coordinates.
    Returns (n, 3) float64: unit normals of arbitrary sign.
    """
    o3d = library()
    cloud = open3d_cloud(Frame.around(points, offset=DOUBLE_OFFSET).inward(points))
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(n_neighbors))
    return np.array(cloud.normals)


def orient_by_tangent_planes(points: FloatArray, normals: FloatArray, *, n_neighbors: int) -> FloatArray:
    """Orient normals consistently along a minimum spanning tree of the tangent planes [1]_.

    points, normals: (n, 3) float64, coordinates and unit normals.
    Returns (n, 3) float64: the normals or their opposites.

    References
    ----------
    .. [1] Hoppe et al., "Surface reconstruction from unorganized points", SIGGRAPH 1992.
    """
    cloud = open3d_cloud(Frame.around(points, offset=DOUBLE_OFFSET).inward(points), normals)
    try:
        cloud.orient_normals_consistent_tangent_plane(n_neighbors)
    except RuntimeError as error:  # from Qhull: the points coincide in its precision
        raise ReconstructionError(
            f"tangent planes need a Delaunay triangulation, and {len(points)} points have none: look for "
            "points that coincide or lie far from the body, and drop them",
            stage=Stage.ORIENT,
        ) from error
    return np.array(cloud.normals)


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
