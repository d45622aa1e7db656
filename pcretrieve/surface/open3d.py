"""Poisson reconstruction and simplification by Open3D, as functions of arrays."""

from __future__ import annotations

import numpy as np

from pcretrieve.arrays import DOUBLE_OFFSET, Frame, diagonal
from pcretrieve.draw.open3d import library, open3d_cloud, open3d_mesh
from pcretrieve.errors import ReconstructionError
from pcretrieve.values import FloatArray, IntArray

# Binary digits of a coordinate in single precision: in a cube of side 1, points nearer than 2**-24 coincide.
SINGLE_DIGITS = 24

# Fewer points than this bound no surface; and the number of points among which so many are looked for first.
FEWEST_POINTS = 100

SOME = 1000

# Surfaces with diagonals in this range are simplified in the caller's unit of length, see `simplify`.
ORDINARY = 1e-6, 1e6


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
