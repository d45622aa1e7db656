"""Random points of a surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pcretrieve.values import FloatArray, TriangleMesh

__all__ = ["uniform_points"]


def uniform_points(
    mesh: TriangleMesh, n: int, rng: np.random.Generator
) -> tuple[FloatArray, NDArray[np.intp]]:
    """Random points of a surface, uniform by area [1]_.

    Returns points : (n, 3) float64: in the unit of the mesh.
    Returns faces : (n,) intp: number of the face that each point lies on.

    References
    ----------
    .. [1] Osada, Funkhouser, Chazelle and Dobkin, "Shape distributions", ACM TOG 2002, equation (1).
    """
    areas = mesh.face_areas  # (m,)
    faces = rng.choice(len(areas), size=n, p=areas / areas.sum())
    # The square root makes the barycentric coordinates uniform over the triangle.
    u, v = np.sqrt(rng.random(n)), rng.random(n)
    weights = np.column_stack([1 - u, u * (1 - v), u * v])  # (n, 3)
    points: FloatArray = np.einsum("nk,nkd->nd", weights, mesh.vertices[mesh.faces[faces]])
    return points, faces
