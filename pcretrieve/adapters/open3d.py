"""Open3D, as functions of arrays.

Open3D is run on one thread: its parallel Poisson reconstruction is not reproducible and crashes in long runs
(Open3D issues 6828 and 7229). A batch processes several shapes in parallel instead.

Poisson reconstruction and ray casting compute in single precision: squares of lengths overflow beyond
1e19 and vanish below 1e-22; Open3D then gives NaN, or ends the process by a segmentation fault. All functions
therefore transform coordinates to a `Frame` of unit size before Open3D sees them, and transform results back.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache
from importlib import import_module
from threading import RLock
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcretrieve.adapters.frame import DOUBLE_OFFSET, Frame, diagonal
from pcretrieve.arrays import FloatArray, IntArray
from pcretrieve.errors import ReconstructionError, Stage

__all__ = [
    "estimate_normals",
    "library",
    "open3d_cloud",
    "open3d_mesh",
    "orient_by_tangent_planes",
    "poisson",
    "simplify",
    "statistical_inliers",
]

# Binary digits of a coordinate in single precision: in a cube of side 1, points nearer than 2**-24 coincide.
SINGLE_DIGITS = 24

# Fewer points than this bound no surface; and the number of points among which so many are looked for first.
FEWEST_POINTS = 100
SOME = 1000

# The module of the viewer in a browser.
VIEWER = "open3d.visualization.draw_plotly"

# Surfaces with diagonals in this range are simplified in the caller's unit of length, see `simplify`.
ORDINARY = 1e-6, 1e6


# A search page imports Open3D in several threads at a time.
IMPORTING = RLock()


def library() -> Any:
    """Import Open3D."""
    with IMPORTING:
        return _quiet_library()


@cache
def _quiet_library() -> Any:
    open3d = _imported()
    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    # OMP_NUM_THREADS has no effect from 0.20 on; older versions have no set_max_threads.
    if hasattr(open3d.utility, "set_max_threads"):
        open3d.utility.set_max_threads(1)
    return open3d


def _imported() -> Any:
    """Import Open3D without its viewer in a browser, which needs dash and plotly: half of the time."""
    if "open3d" in sys.modules:
        import open3d

        return open3d
    sys.modules[VIEWER] = stand_in = ModuleType(VIEWER)
    stand_in.__getattr__ = _later  # type: ignore[method-assign]
    try:
        import open3d
    finally:
        del sys.modules[VIEWER]
    return open3d


def _later(name: str) -> Callable[..., Any]:
    """A function of the viewer, which is imported when the function is called."""
    if name.startswith("__"):
        raise AttributeError(name)
    return lambda *args, **options: getattr(import_module(VIEWER), name)(*args, **options)


# --- exchange ----------------------------------------------------------------------------------------


def _vectors(values: FloatArray) -> Any:
    """A copy, because Open3D does not accept read-only arrays."""
    return library().utility.Vector3dVector(np.array(values, dtype=np.float64))


# --- points -------------------------------------------------------------------------------------------


def open3d_cloud(points: FloatArray, normals: FloatArray | None = None) -> Any:
    """A point cloud of Open3D.

    points: (n, 3) float64, in any unit.
    normals: (n, 3) float64, optional, normals of the points.
    """
    o3d = library()
    cloud = o3d.geometry.PointCloud(_vectors(points))
    if normals is not None:
        cloud.normals = _vectors(normals)
    return cloud


def statistical_inliers(points: FloatArray, *, n_neighbors: int, std_ratio: float) -> NDArray[np.intp]:
    """Statistical outlier removal: the points whose mean distance to their neighbours is not exceptional.

    points: (n, 3) float64, coordinates.
    Returns (k,) int: positions of the points that are kept, ascending.
    """
    cloud = open3d_cloud(Frame.around(points, offset=DOUBLE_OFFSET).inward(points))
    _, kept = cloud.remove_statistical_outlier(nb_neighbors=n_neighbors, std_ratio=std_ratio)
    return np.sort(np.asarray(kept, dtype=np.intp))


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


# --- surfaces -----------------------------------------------------------------------------------------


def open3d_mesh(vertices: FloatArray, faces: IntArray) -> Any:
    """A triangle mesh of Open3D.

    vertices: (n, 3) float64, in any unit.
    faces: (m, 3) int32, vertex numbers.
    """
    o3d = library()
    return o3d.geometry.TriangleMesh(_vectors(vertices), o3d.utility.Vector3iVector(faces.copy()))


def poisson(
    points: FloatArray, normals: FloatArray, *, depth: int, scale: float
) -> tuple[FloatArray, IntArray, FloatArray]:
    """Screened Poisson reconstruction [1]_.

    points, normals: (p, 3) float64, coordinates and unit normals that point outwards.
    Returns vertices : (n, 3) float64: coordinates.
    Returns faces : (m, 3) int32: vertex numbers of each face, counter-clockwise seen from outside.
    Returns density : (n,) float64: depth of the octree at each vertex; larger where there are more points.

    References
    ----------
    .. [1] Kazhdan and Hoppe, "Screened Poisson surface reconstruction", ACM TOG 2013.
    """
    frame = Frame.around(points)
    framed = frame.inward(points)
    _check_resolved(framed)
    mesh, density = library().geometry.TriangleMesh.create_from_point_cloud_poisson(
        open3d_cloud(framed, normals), depth=depth, scale=scale, n_threads=1
    )
    vertices = np.array(mesh.vertices)
    if not np.isfinite(vertices).all():
        raise ReconstructionError(
            f"Poisson reconstruction must give finite vertices, {len(points)} points gave "
            f"{np.isfinite(vertices).all(axis=1).sum()} of {len(vertices)}: look for points that are no part "
            "of the body, and drop them"
        )
    return frame.outward(vertices), np.array(mesh.triangles, dtype=np.int32), np.array(density)


def _check_resolved(framed: FloatArray) -> None:
    """Whether points, in their frame, are distinct in single precision."""
    n_distinct = 0
    # A few of the points mostly suffice, and take a twentieth of the time of all points.
    for some in (framed[:: 1 + len(framed) // SOME], framed):
        n_distinct = len(np.unique(np.round(np.ldexp(some, SINGLE_DIGITS)), axis=0))
        if n_distinct >= FEWEST_POINTS:
            return
    raise ReconstructionError(
        f"at least {FEWEST_POINTS} points must be distinct in single precision, relative to the diagonal "
        f"of all points; of {len(framed)} points {n_distinct} are: look for points far from the body "
        "and drop them"
    )


def simplify(vertices: FloatArray, faces: IntArray, *, n_faces: int) -> tuple[FloatArray, IntArray]:
    """Simplify a surface by edge collapse with quadric error metrics [1]_.

    vertices: (n, 3) float64, coordinates.
    faces: (m, 3) int32, vertex numbers of each face.
    Returns vertices : (p, 3) float64: coordinates.
    Returns faces : (q, 3) int32: vertex numbers of each face.

    References
    ----------
    .. [1] Garland and Heckbert, "Surface simplification using quadric error metrics", SIGGRAPH 1997.
    """
    frame = Frame.around(vertices, offset=DOUBLE_OFFSET)
    # Open3D compares determinants of quadrics with 1e-4 in any unit of length, so another unit gives other
    # vertices. It computes in double precision here: ordinary lengths need no frame.
    if ORDINARY[0] <= diagonal(vertices) <= ORDINARY[1]:
        frame = Frame(np.zeros(3), 1.0)
    mesh = open3d_mesh(frame.inward(vertices), faces).simplify_quadric_decimation(n_faces)
    return frame.outward(np.array(mesh.vertices)), np.array(mesh.triangles, dtype=np.int32)
