"""Random points on a surface."""

from __future__ import annotations

import numpy as np

from pcretrieve.types import FloatArray, TriangleMesh

__all__ = ["uniform_points"]


def uniform_points(mesh: TriangleMesh, n: int, rng: np.random.Generator) -> FloatArray:
    """Random points on a mesh, with uniform density by area.

    A triangle is drawn with a probability proportional to its area, and a point of the triangle by equation
    (1) of [1]_, whose square root makes the density uniform.

    Parameters
    ----------
    mesh : TriangleMesh
        Of positive area.
    n : int
        Number of points.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    (n, 3) float64
        In the unit of the mesh.

    References
    ----------
    .. [1] Osada, Funkhouser, Chazelle and Dobkin, "Shape distributions", ACM Transactions on Graphics 2002.
    """
    areas = mesh.face_areas  # (m,)
    face = rng.choice(len(mesh.faces), size=n, p=areas / areas.sum())  # (n,)
    u, v = np.sqrt(rng.random(n)), rng.random(n)
    weights = np.column_stack([1 - u, u * (1 - v), u * v])  # (n, 3), barycentric coordinates
    points: FloatArray = np.einsum("nk,nkd->nd", weights, mesh.vertices[mesh.faces[face]])
    return points
