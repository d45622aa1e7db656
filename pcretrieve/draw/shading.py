"""Lamps and the colour of surfaces."""

from __future__ import annotations

import numpy as np

from pcretrieve.arrays import FloatArray, IntArray

__all__ = ["CLAY", "face_brightness"]

#: The colour of surfaces: a light clay, visible on white and on black; sRGB in [0, 1].
CLAY = (0.86, 0.80, 0.74)

# Directions to the two lamps in the frame of the camera (right, up, towards), and their strengths: a key
# light from the upper left, and a weak fill light from the right.
LIGHTS = (((-0.5, 0.7, 0.8), 0.72), ((0.9, 0.1, 0.5), 0.22))
AMBIENT = 0.26


def face_brightness(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """The brightness of the faces of a matt surface by Lambert's law; both sides of a face look alike.

    vertices: (n, 3) float64, coordinates in the frame of the camera: right, up, towards.
    faces: (m, 3) int32, vertex numbers of the triangles.
    Returns (m,) float64: in [0, 1].
    """
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)  # (m, 3)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny)
    normals *= np.where(normals[:, 2:] < 0, -1, 1)
    light = np.full(len(normals), AMBIENT)
    for direction, strength in LIGHTS:
        light += strength * np.maximum(normals @ direction / np.linalg.norm(direction), 0)
    brightness: FloatArray = np.minimum(light, 1)
    return brightness
