"""Scans of bodies by several sensors: cameras all round, uniform points, a camera beside a turntable."""

from __future__ import annotations

import numpy as np

from benchmarks.bodies import is_outside
from pcretrieve.surface.reconstruct import uniform_points
from pcretrieve.values import FloatArray, IntArray, TriangleMesh

# Noise of uniform points, relative to the diagonal, and number of rays that look for the outside.
NOISE, N_RAYS = 0.001, 48


def outer_points(
    mesh: TriangleMesh, n: int, rng: np.random.Generator
) -> tuple[FloatArray, IntArray]:
    """(n, 3) random points of the part of a surface that is seen from outside, and (n,) their faces."""
    found, faces = uniform_points(mesh, n, rng)
    normals = mesh.area_vectors[faces] / mesh.face_areas[faces, np.newaxis]
    seen = is_outside(mesh, found, normals, N_RAYS)
    while not seen.all():
        again, their = uniform_points(mesh, int((~seen).sum()), rng)
        normals = mesh.area_vectors[their] / mesh.face_areas[their, np.newaxis]
        found[~seen], faces[~seen] = again, their
        seen[~seen] = is_outside(mesh, again, normals, N_RAYS)
    return found, faces


def noisy(mesh: TriangleMesh, points: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Points with isotropic noise."""
    return np.asarray(points + rng.normal(0, NOISE * mesh.diagonal, points.shape))
