"""Faults that scans of every kind have: holes and outliers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pcretrieve.values import FloatArray, TriangleMesh

__all__ = ["box_centre", "outliers", "outside_holes"]

# Outliers lie in the bounding box of the surface, enlarged by this factor about its centre.
OUTLIER_BOX = 1.2


def outside_holes(points: FloatArray, centres: FloatArray, radius: float) -> NDArray[np.bool_]:
    """Find the points outside all holes of a scan.

    points: (n, 3) float64, points of the surface.
    centres: (h, 3) float64, centres of the holes, which are balls.
    radius: radius of the holes; unit of the points.
    Returns (n,) bool: whether each point is in no hole.
    """
    outside = np.ones(len(points), dtype=bool)
    for centre in centres:
        outside &= np.linalg.norm(points - centre, axis=1) >= radius
    return outside


def outliers(mesh: TriangleMesh, n: int, rng: np.random.Generator) -> FloatArray:
    """Random points in the bounding box of a surface, enlarged by a fifth.

    Returns (n, 3) float64: in the unit of the mesh.
    """
    extent = np.ptp(mesh.vertices, axis=0)
    points: FloatArray = box_centre(mesh) + OUTLIER_BOX * extent * rng.uniform(-0.5, 0.5, (n, 3))
    return points


def box_centre(mesh: TriangleMesh) -> FloatArray:
    """Centre of the bounding box of a surface.

    Returns (3,) float64: in the unit of the mesh.
    """
    centre: FloatArray = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    return centre
