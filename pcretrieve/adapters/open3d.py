"""Open3D, as functions on arrays.

Open3D's own threads are not used: its parallel Poisson reconstruction is neither reproducible nor safe in
long runs (Open3D issues 6828 and 7229), and a batch fills the cores with shapes instead.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcretrieve.types import FloatArray, IntArray

__all__ = [
    "RayScene",
    "estimate_normals",
    "feature_histograms",
    "geometry_arrays",
    "orient_by_tangent_planes",
    "poisson",
    "simplify",
    "statistical_inliers",
]


@cache
def _open3d() -> Any:
    """The module, quiet and on one thread."""
    import open3d

    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    # OMP_NUM_THREADS has no effect from 0.20 on; older versions have no set_max_threads.
    if hasattr(open3d.utility, "set_max_threads"):
        open3d.utility.set_max_threads(1)
    return open3d


# --- exchange ----------------------------------------------------------------------------------------


def geometry_arrays(geometry: object) -> tuple[FloatArray, IntArray | None, FloatArray | None]:
    """Points, faces or None, unit normals or None, of an Open3D point cloud or mesh, legacy or tensor.

    Raises
    ------
    TypeError
        For anything else.
    """
    o3d = _open3d()
    if isinstance(geometry, (o3d.t.geometry.PointCloud, o3d.t.geometry.TriangleMesh)):
        geometry = geometry.to_legacy()
    if isinstance(geometry, o3d.geometry.TriangleMesh):
        return np.array(geometry.vertices), np.array(geometry.triangles), None
    if isinstance(geometry, o3d.geometry.PointCloud):
        return np.array(geometry.points), None, _unit_normals(geometry)
    raise TypeError(f"neither a point cloud nor a triangle mesh: {type(geometry).__name__}")


def _unit_normals(cloud: Any) -> FloatArray | None:
    if not cloud.has_normals():
        return None
    normals = np.array(cloud.normals)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / np.where(length > 0, length, 1)


def _vectors(values: FloatArray) -> Any:
    """A copy: Open3D refuses the locked arrays of pcretrieve's types."""
    return _open3d().utility.Vector3dVector(np.array(values, dtype=np.float64))


# --- points -------------------------------------------------------------------------------------------


def _cloud(points: FloatArray, normals: FloatArray | None = None) -> Any:
    o3d = _open3d()
    cloud = o3d.geometry.PointCloud(_vectors(points))
    if normals is not None:
        cloud.normals = _vectors(normals)
    return cloud


def statistical_inliers(points: FloatArray, *, n_neighbors: int, std_ratio: float) -> NDArray[np.intp]:
    """Positions of the points whose mean distance to their neighbours is not unusual, ascending."""
    _, kept = _cloud(points).remove_statistical_outlier(nb_neighbors=n_neighbors, std_ratio=std_ratio)
    return np.sort(np.asarray(kept, dtype=np.intp))


def estimate_normals(points: FloatArray, *, n_neighbors: int) -> FloatArray:
    """(n, 3) unit normals of the best plane through each point's neighbours; the sign is arbitrary."""
    o3d = _open3d()
    cloud = _cloud(points)
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(n_neighbors))
    return np.array(cloud.normals)


def orient_by_tangent_planes(points: FloatArray, normals: FloatArray, *, n_neighbors: int) -> FloatArray:
    """(n, 3) normals made consistent along a minimum spanning tree [1]_.

    References
    ----------
    .. [1] Hoppe et al., "Surface reconstruction from unorganized points", SIGGRAPH 1992.
    """
    cloud = _cloud(points, normals)
    cloud.orient_normals_consistent_tangent_plane(n_neighbors)
    return np.array(cloud.normals)


# --- surfaces -----------------------------------------------------------------------------------------


def _mesh(vertices: FloatArray, faces: IntArray) -> Any:
    o3d = _open3d()
    return o3d.geometry.TriangleMesh(_vectors(vertices), o3d.utility.Vector3iVector(faces.copy()))


def poisson(
    points: FloatArray, normals: FloatArray, *, depth: int, scale: float
) -> tuple[FloatArray, IntArray, FloatArray]:
    """Screened Poisson reconstruction [1]_.

    Returns
    -------
    vertices : (n, 3) float64
    faces : (m, 3) int32
    density : (n,) float64
        Octree depth that the points support at each vertex; larger is denser.

    References
    ----------
    .. [1] Kazhdan and Hoppe, "Screened Poisson surface reconstruction", ACM TOG 2013.
    """
    mesh, density = _open3d().geometry.TriangleMesh.create_from_point_cloud_poisson(
        _cloud(points, normals), depth=depth, scale=scale, n_threads=1
    )
    return np.array(mesh.vertices), np.array(mesh.triangles, dtype=np.int32), np.array(density)


def simplify(vertices: FloatArray, faces: IntArray, *, n_faces: int) -> tuple[FloatArray, IntArray]:
    """The surface with about `n_faces` faces, by quadric error [1]_.

    References
    ----------
    .. [1] Garland and Heckbert, "Surface simplification using quadric error metrics", SIGGRAPH 1997.
    """
    mesh = _mesh(vertices, faces).simplify_quadric_decimation(n_faces)
    return np.array(mesh.vertices), np.array(mesh.triangles, dtype=np.int32)


class RayScene:
    """A surface to cast rays at.

    Parameters
    ----------
    vertices : (n, 3) float64
    faces : (m, 3) int32
    """

    def __init__(self, vertices: FloatArray, faces: IntArray) -> None:
        o3d = _open3d()
        self._tensor = o3d.core.Tensor
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        self._scene.add_triangles(
            o3d.core.Tensor(np.asarray(vertices, dtype=np.float32)),
            o3d.core.Tensor(np.asarray(faces, dtype=np.uint32)),
        )

    def cast(self, origins: FloatArray, directions: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
        """First hit of each ray.

        Parameters
        ----------
        origins, directions : (k, 3) float64

        Returns
        -------
        distance : (k,) float64
            In lengths of the direction; infinite where a ray hits nothing.
        normals : (k, 3) float64
            Unit normal of the face that was hit, as the face is oriented.
        face : (k,) int32
            Number of that face; -1 where a ray hits nothing.
        """
        rays = np.concatenate([origins, directions], axis=1).astype(np.float32)  # (k, 6)
        answer = self._scene.cast_rays(self._tensor(rays))
        distance = answer["t_hit"].numpy().astype(np.float64)
        face = np.where(np.isfinite(distance), answer["primitive_ids"].numpy().astype(np.int64), -1)
        normals = answer["primitive_normals"].numpy().astype(np.float64)
        return distance, normals, face.astype(np.int32)

    def distance(self, points: FloatArray) -> FloatArray:
        """(k,) distance to the surface."""
        query = self._tensor(np.asarray(points, dtype=np.float32))
        return np.asarray(self._scene.compute_distance(query).numpy(), dtype=np.float64)


# --- features -----------------------------------------------------------------------------------------


def feature_histograms(points: FloatArray, normals: FloatArray, *, radius: float) -> FloatArray:
    """(n, 33) fast point feature histograms [1]_: how normals turn within `radius` of each point.

    They do not change when the points move.

    References
    ----------
    .. [1] Rusu et al., "Fast point feature histograms (FPFH) for 3D registration", ICRA 2009.
    """
    o3d = _open3d()
    search = o3d.geometry.KDTreeSearchParamRadius(radius)
    features = o3d.pipelines.registration.compute_fpfh_feature(_cloud(points, normals), search)
    return np.array(features.data.T)  # (n, 33)
