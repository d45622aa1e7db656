"""Where a simulated body rests on the ground and on a seat, which no sensor sees."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pcretrieve.values import FloatArray, TriangleMesh

__all__ = ["SEATED", "on_support"]

#: Poses of people who sit on a seat.
SEATED = ("sit", "legs_crossed")

# Largest height above a support at which soft parts touch it, and extent of the hips about the origin, to the
# sides and to the front; diagonals.
TOUCHING = 0.015
HIPS = (0.12, 0.05)

# Largest vertical part of the unit normal of a surface that faces down.
DOWN = -0.5


def on_support(mesh: TriangleMesh, points: FloatArray, *, seated: bool) -> NDArray[np.bool_]:
    """The points of a person at which the body touches the ground or a seat.

    points: (n, 3) float64, points on the surface, with noise; unit of the mesh.
    Returns (n,) bool: points of faces that face down, near the lowest point of the body or of the hips.
    """
    x, y, z = mesh.vertices.T
    supports = [y.min()]
    if seated:
        supports.append(y[(abs(x) < HIPS[0] * mesh.diagonal) & (abs(z) < HIPS[1] * mesh.diagonal)].min())
    _, nearest = cKDTree(mesh.vertices[mesh.faces].mean(axis=1)).query(points)
    faces_down = mesh.area_vectors[nearest, 1] < DOWN * mesh.face_areas[nearest]
    heights = abs(points[:, 1, None] - np.array(supports)).min(axis=1)
    return np.asarray(faces_down & (heights < TOUCHING * mesh.diagonal))
