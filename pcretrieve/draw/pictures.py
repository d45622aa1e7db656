"""Pictures of points and surfaces in given colours, and the lamps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw

from pcretrieve.arrays import FloatArray, IntArray
from pcretrieve.draw.camera import SUPERSAMPLING, Camera, pooled, visible_faces

#: Red, green and blue in [0, 1].
Colour = tuple[float, float, float]

#: The colour of surfaces: a light clay, visible on white and on black; sRGB in [0, 1].
CLAY = (0.86, 0.80, 0.74)

# Directions to the two lamps in the frame of the camera (right, up, towards), and their strengths: a key
# light from the upper left, and a weak fill light from the right.
LIGHTS = (((-0.5, 0.7, 0.8), 0.72), ((0.9, 0.1, 0.5), 0.22))
AMBIENT = 0.26

# Limits of the side of the square of a point: the smallest in pixels, so that no point is lost; the largest
# relative to half of the side of the picture, for sparse points.
LEAST_WIDTH, LARGEST_WIDTH = 1.5, 0.05


def point_picture(
    points: FloatArray, colours: FloatArray, camera: Camera, *, width: float, size: int
) -> Image.Image:
    """A picture of points, drawn as squares that face the camera.

    points: (n, 3) float64, coordinates; unit of the camera.
    colours: (n, 3) float64, red, green and blue in [0, 1].
    width: side of a square, within limits; unit of the camera.
    size: side of the picture; pixels.
    """
    half = max(min(width / camera.half, LARGEST_WIDTH), 2 * LEAST_WIDTH / size) / 2
    corners = half * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    vertices = (camera.seen(points)[:, None] + corners).reshape(-1, 3)  # (4n, 3)
    first = 4 * np.arange(len(points), dtype=np.int32)  # (n,)
    faces = np.concatenate(
        [np.column_stack([first, first + 1, first + 2]), np.column_stack([first, first + 2, first + 3])]
    )
    return _picture(vertices, faces, np.tile(colours, (2, 1)), size)


def surface_picture(
    vertices: FloatArray,
    faces: IntArray,
    colours: FloatArray,
    camera: Camera,
    *,
    size: int,
    rings: Sequence[tuple[FloatArray, Colour]] = (),
) -> Image.Image:
    """A picture of a surface, lit by the lamps of `face_brightness`.

    vertices: (n, 3) float64, vertices of the surface; unit of the camera.
    faces: (m, 3) int32, vertex numbers of the triangles.
    colours: (m, 3) float64, colours of the faces; red, green and blue in [0, 1].
    size: side of the picture; pixels.
    rings: sequence of ((k, 3) positions, colour), positions around which rings are drawn, also behind the
        surface.
    """
    seen = camera.seen(vertices)
    picture = _picture(seen, faces, colours * face_brightness(seen, faces)[:, None], size)
    pen = ImageDraw.Draw(picture)
    radius = size / 45
    for positions, colour in rings:
        for x, y in (camera.seen(positions)[:, :2] * [1, -1] + 1) * size / 2:
            box = (x - radius, y - radius, x + radius, y + radius)
            pen.ellipse(box, outline=rgb(colour), width=max(round(size / 140), 1))
    return picture


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


def rgb(colour: Colour) -> tuple[int, int, int]:
    """A colour as three integers from 0 to 255."""
    red, green, blue = (round(255 * part) for part in colour)
    return red, green, blue


def css(colour: Colour) -> str:
    """A colour as a hexadecimal value of CSS."""
    return "#" + bytes(rgb(colour)).hex()


def _picture(vertices: FloatArray, faces: IntArray, colours: FloatArray, size: int) -> Image.Image:
    """A picture of (size, size) pixels of the field of view [-1, 1]², with a transparent background."""
    palette = np.concatenate([np.column_stack([colours, np.ones(len(colours))]), np.zeros((1, 4))])
    pixels = pooled(palette[visible_faces(vertices, faces, size)])  # face −1, none, is the last row
    # The mean over the rays that hit a face, so that edges are not darker.
    pixels[..., :3] /= np.maximum(pixels[..., 3:], 1 / SUPERSAMPLING**2)
    return Image.fromarray(np.round(255 * np.minimum(pixels, 1)).astype(np.uint8), "RGBA")
