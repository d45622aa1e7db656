"""Ray casting on surfaces by Open3D, as functions of arrays."""

from __future__ import annotations

import numpy as np

from pcretrieve.adapters.frame import Frame, power_of_two
from pcretrieve.adapters.open3d import library
from pcretrieve.arrays import FloatArray, IntArray

__all__ = ["RayScene"]


class RayScene:
    """A surface for ray casting and distance queries, in single precision.

    vertices: (n, 3) float64, coordinates.
    faces: (m, 3) int32, vertex numbers of each face.
    """

    def __init__(self, vertices: FloatArray, faces: IntArray) -> None:
        o3d = library()
        self._tensor = o3d.core.Tensor
        self._frame = Frame.around(vertices)
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        self._scene.add_triangles(
            o3d.core.Tensor(self._frame.inward(vertices).astype(np.float32)),
            o3d.core.Tensor(np.asarray(faces, dtype=np.uint32)),
        )

    def cast(self, origins: FloatArray, directions: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
        """The first intersection of each ray with the surface.

        origins, directions: (k, 3) float64, origins and directions of the rays; the directions may have any
            length.
        Returns distance : (k,) float64: distance from the origin in units of the length of the direction;
            infinite if there is none.
        Returns normals : (k, 3) float64: unit normals of the faces, by their orientation.
        Returns face : (k,) int32: numbers of the faces; −1 if there is no intersection.
        """
        length = power_of_two(float(np.abs(directions).max(initial=0)))
        rays = np.concatenate([self._frame.inward(origins), directions / length], axis=1)  # (k, 6)
        answer = self._scene.cast_rays(self._tensor(rays.astype(np.float32)))
        distance = answer["t_hit"].numpy().astype(np.float64) * (self._frame.size / length)
        face = np.where(np.isfinite(distance), answer["primitive_ids"].numpy().astype(np.int64), -1)
        normals = answer["primitive_normals"].numpy().astype(np.float64)
        return distance, normals, face.astype(np.int32)

    def distance(self, points: FloatArray) -> FloatArray:
        """(k,) unsigned distances of (k, 3) points to the surface."""
        query = self._tensor(self._frame.inward(points).astype(np.float32))
        framed: FloatArray = self._scene.compute_distance(query).numpy().astype(np.float64)
        return framed * self._frame.size
