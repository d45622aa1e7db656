"""Open3D, as functions of arrays: its import, its geometry, and ray casting.

Open3D is run on one thread: its parallel Poisson reconstruction is not reproducible and crashes in long runs
(Open3D issues 6828 and 7229). A batch processes several shapes in parallel instead.

Poisson reconstruction and ray casting compute in single precision: squares of lengths overflow beyond 1e19
and vanish below 1e-22; Open3D then gives NaN, or ends the process by a segmentation fault. All functions that
call it therefore transform coordinates to a `Frame` of unit size before, and results back.
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

from pcretrieve.arrays import FloatArray, Frame, IntArray, power_of_two

# The module of the viewer in a browser.
VIEWER = "open3d.visualization.draw_plotly"

# A search page imports Open3D in several threads at a time.
IMPORTING = RLock()


def library() -> Any:
    """Import Open3D."""
    with IMPORTING:
        return _imported()


@cache
def _imported() -> Any:
    """Import Open3D without its viewer in a browser, which needs dash and plotly: half of the time."""
    is_first = "open3d" not in sys.modules
    if is_first:
        sys.modules[VIEWER] = stand_in = ModuleType(VIEWER)
        stand_in.__getattr__ = _later  # type: ignore[method-assign]
    try:
        import open3d
    finally:
        if is_first:
            del sys.modules[VIEWER]
    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    open3d.utility.set_max_threads(1)  # OMP_NUM_THREADS has no effect
    return open3d


def _later(name: str) -> Callable[..., Any]:
    """A function of the viewer, which is imported when the function is called."""
    if name.startswith("__"):
        raise AttributeError(name)
    return lambda *args, **options: getattr(import_module(VIEWER), name)(*args, **options)


def _vectors(values: FloatArray) -> Any:
    """A copy, because Open3D does not accept read-only arrays."""
    return library().utility.Vector3dVector(np.array(values, dtype=np.float64))


def open3d_cloud(
    points: FloatArray, normals: FloatArray | None = None, *, tensor: bool = False
) -> Any:
    """A point cloud of Open3D, with (n, 3) points and normals; of tensors on request."""
    cloud = library().geometry.PointCloud(_vectors(points))
    if normals is not None:
        cloud.normals = _vectors(normals)
    return (
        library().t.geometry.PointCloud.from_legacy(cloud, library().core.float64)
        if tensor
        else cloud
    )


def open3d_mesh(vertices: FloatArray, faces: IntArray, *, tensor: bool = False) -> Any:
    """A triangle mesh of Open3D; of tensors on request."""
    o3d = library()
    mesh = o3d.geometry.TriangleMesh(
        _vectors(vertices), o3d.utility.Vector3iVector(faces.copy())
    )
    return (
        o3d.t.geometry.TriangleMesh.from_legacy(mesh, o3d.core.float64)
        if tensor
        else mesh
    )


class RayScene:
    """A surface for ray casting and distance queries, in single precision."""

    def __init__(self, vertices: FloatArray, faces: IntArray) -> None:
        o3d = library()
        self._tensor = o3d.core.Tensor
        self._frame = Frame.around(vertices)
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        self._scene.add_triangles(
            o3d.core.Tensor(self._frame.inward(vertices).astype(np.float32)),
            o3d.core.Tensor(np.asarray(faces, dtype=np.uint32)),
        )

    def cast(
        self, origins: FloatArray, directions: FloatArray
    ) -> tuple[FloatArray, FloatArray, IntArray]:
        """The first intersection of each ray with the surface.

        origins, directions: (k, 3); the directions may have any length.
        Returns distance: (k,), from the origin in units of the length of the direction; infinite if there is
            none.
        Returns normals: (k, 3), unit normals of the faces, by their orientation.
        Returns face: (k,), numbers of the faces; −1 if there is none.
        """
        length = power_of_two(float(np.abs(directions).max(initial=0)))
        rays = np.concatenate(
            [self._frame.inward(origins), directions / length], axis=1
        )  # (k, 6)
        answer = self._scene.cast_rays(self._tensor(rays.astype(np.float32)))
        distance = answer["t_hit"].numpy().astype(np.float64) * (
            self._frame.size / length
        )
        face = np.where(
            np.isfinite(distance), answer["primitive_ids"].numpy().astype(np.int64), -1
        )
        normals = answer["primitive_normals"].numpy().astype(np.float64)
        return distance, normals, face.astype(np.int32)

    def distance(self, points: FloatArray) -> FloatArray:
        """(k,) unsigned distances of (k, 3) points to the surface."""
        query = self._tensor(self._frame.inward(points).astype(np.float32))
        framed: FloatArray = (
            self._scene.compute_distance(query).numpy().astype(np.float64)
        )
        return framed * self._frame.size
