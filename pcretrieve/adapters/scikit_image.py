"""Level sets by scikit-image: samples on a grid in, a triangle mesh or contours out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pcretrieve.arrays import FloatArray, IntArray

__all__ = ["contours", "level_surface"]


def contours(picture: FloatArray, level: float) -> Sequence[FloatArray]:
    """Level curves of a picture, by marching squares.

    picture: (h, w) float64, the samples, interpolated bilinearly.
    Returns sequence of (n, 2) float64: the polygons, by row and column; the first and the last point of a
        closed one are equal.
    """
    from skimage.measure import find_contours

    return [np.asarray(contour, dtype=np.float64) for contour in find_contours(picture, level)]


def level_surface(field: FloatArray, cell: float) -> tuple[FloatArray, IntArray]:
    """Zero level set of a field, by marching cubes.

    field: (x, y, z) float64, the samples, negative inside.
    Returns vertices : (n, 3) float64: in the unit of `cell`, relative to the first sample.
    Returns faces : (m, 3) int32: vertices of each triangle.
    """
    from skimage.measure import marching_cubes

    vertices, faces, _, _ = marching_cubes(field, 0.0, spacing=(cell,) * 3)
    return np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int32)
