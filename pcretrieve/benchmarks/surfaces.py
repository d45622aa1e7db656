"""Test surfaces of any size, made by formula or by subdivision."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull

from pcretrieve.values import TriangleMesh

__all__ = ["bumpy_sphere", "quartered", "unit_square"]


def bumpy_sphere(n: int) -> TriangleMesh:
    """A closed surface of `n` vertices without any symmetry, so that no two eigenvalues are equal.

    It is a sphere that is sampled on a Fibonacci spiral, displaced by a smooth function, and stretched to an
    ellipsoid.

    Parameters
    ----------
    n : int
        Number of vertices, at least 4.

    Returns
    -------
    TriangleMesh
        Closed, pointing outwards, of Euler characteristic 2.
    """
    height = 1 - (2 * np.arange(n) + 1) / n
    angle = np.pi * (1 + np.sqrt(5)) * np.arange(n)
    flat = np.sqrt(1 - height**2)
    points = np.stack([flat * np.cos(angle), flat * np.sin(angle), height], axis=1)  # (n, 3)
    faces = ConvexHull(points).simplices
    normals = np.cross(points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]])
    inwards = (normals * points[faces[:, 0]]).sum(axis=1) < 0
    faces[inwards] = faces[inwards, ::-1]
    x, y, z = points.T
    radius = 1 + 0.25 * np.sin(3 * x + 1) * np.cos(4 * y) + 0.2 * np.sin(5 * z + x)
    return TriangleMesh(radius[:, None] * points * [1.5, 1.0, 0.8], faces)


def quartered(mesh: TriangleMesh) -> TriangleMesh:
    """The same surface with each face cut in four at the midpoints of its edges.

    Parameters
    ----------
    mesh : TriangleMesh
        Any surface.

    Returns
    -------
    TriangleMesh
        Four times as many faces; the first vertices are those of `mesh`.
    """
    ends = np.sort(
        np.concatenate([mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]], mesh.faces[:, [0, 1]]]), axis=1
    )
    edges, of_face = np.unique(ends, axis=0, return_inverse=True)
    a, b, c = mesh.faces.T
    opposite_a, opposite_b, opposite_c = of_face.reshape(3, -1) + len(mesh.vertices)
    corners = [
        (a, opposite_c, opposite_b),
        (b, opposite_a, opposite_c),
        (c, opposite_b, opposite_a),
        (opposite_a, opposite_b, opposite_c),
    ]
    return TriangleMesh(
        np.concatenate([mesh.vertices, mesh.vertices[edges].mean(axis=1)]),
        np.concatenate([np.stack(corner, axis=1) for corner in corners]),
    )


def unit_square(n: int) -> TriangleMesh:
    """The flat unit square, cut into n × n cells of two triangles each.

    Parameters
    ----------
    n : int
        Cells along a side.

    Returns
    -------
    TriangleMesh
        (n + 1)² vertices with z = 0; the faces point upwards.
    """
    number = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = (
        part.ravel() for part in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])
    )
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])]).astype(np.int32)
    x, y = np.divmod(number.ravel(), n + 1)
    return TriangleMesh(np.column_stack([x, y, 0 * x]) / n, faces)
