"""Pictures of points and surfaces in colours that mean something."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw

from pcretrieve.arrays import FloatArray, IntArray
from pcretrieve.rendering.camera import SUPERSAMPLING, View, pooled, visible_faces
from pcretrieve.rendering.shading import face_brightness

__all__ = ["Colour", "css", "point_picture", "rgb", "surface_picture"]

#: Red, green and blue in [0, 1].
Colour = tuple[float, float, float]

# Points are drawn as squares at least this wide, so that none is lost; pixels. Few points with much between
# them are drawn no wider than this; half sides of the picture.
LEAST_WIDTH, LARGEST_WIDTH = 1.5, 0.05


def point_picture(
    points: FloatArray, colours: FloatArray, view: View, *, width: float, size: int
) -> Image.Image:
    """Points as squares that face the viewer.

    Parameters
    ----------
    points : (n, 3) float64
        In the unit of the view.
    colours : (n, 3) float64
        Red, green and blue in [0, 1].
    view : View
        From where the picture is taken.
    width : float
        Of a square, within limits; unit of the scan.
    size : int
        Side of the picture; pixels.

    Returns
    -------
    PIL.Image.Image
        RGBA, transparent where nothing is.
    """
    half = max(min(width / view.half, LARGEST_WIDTH), 2 * LEAST_WIDTH / size) / 2
    corners = half * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    vertices = (view.seen(points)[:, None] + corners).reshape(-1, 3)  # (4n, 3)
    first = 4 * np.arange(len(points), dtype=np.int32)  # (n,)
    faces = np.concatenate(
        [np.column_stack([first, first + 1, first + 2]), np.column_stack([first, first + 2, first + 3])]
    )
    return _picture(vertices, faces, np.tile(colours, (2, 1)), size)


def surface_picture(
    vertices: FloatArray,
    faces: IntArray,
    colours: FloatArray,
    view: View,
    *,
    size: int,
    rings: Sequence[tuple[FloatArray, Colour]] = (),
) -> Image.Image:
    """A surface lit by the lamps of `face_brightness`.

    Parameters
    ----------
    vertices : (n, 3) float64
        Vertices of the surface, in any unit.
    faces : (m, 3) int32
        Vertex numbers of the triangles.
    colours : (m, 3) float64
        Of its faces.
    view : View
        From where the picture is taken.
    size : int
        Side of the picture; pixels.
    rings : sequence of ((k, 3) positions, colour)
        Drawn round places on or in the surface, and seen through it.

    Returns
    -------
    PIL.Image.Image
        RGBA, transparent where nothing is.
    """
    seen = view.seen(vertices)
    picture = _picture(seen, faces, colours * face_brightness(seen, faces)[:, None], size)
    pen = ImageDraw.Draw(picture)
    radius = size / 45
    for positions, colour in rings:
        for x, y in (view.seen(positions)[:, :2] * [1, -1] + 1) * size / 2:
            box = (x - radius, y - radius, x + radius, y + radius)
            pen.ellipse(box, outline=rgb(colour), width=max(round(size / 140), 1))
    return picture


def rgb(colour: Colour) -> tuple[int, int, int]:
    """The colour in [0, 255].

    Parameters
    ----------
    colour : (red, green, blue) in [0, 1]
        Red, green and blue.

    Returns
    -------
    tuple of 3 int
    """
    red, green, blue = (round(255 * part) for part in colour)
    return red, green, blue


def css(colour: Colour) -> str:
    """The colour as style sheets write it.

    Parameters
    ----------
    colour : (red, green, blue) in [0, 1]
        Red, green and blue.

    Returns
    -------
    str
        Such as ``#dbccbd``.
    """
    return "#" + bytes(rgb(colour)).hex()


def _picture(vertices: FloatArray, faces: IntArray, colours: FloatArray, size: int) -> Image.Image:
    """What (size, size) pixels see of [-1, 1]² from above, as a picture with a transparent background."""
    palette = np.concatenate([np.column_stack([colours, np.ones(len(colours))]), np.zeros((1, 4))])
    pixels = pooled(palette[visible_faces(vertices, faces, size)])  # face −1, nothing, is the last
    # The mean over the rays that hit, so that edges do not darken.
    pixels[..., :3] /= np.maximum(pixels[..., 3:], 1 / SUPERSAMPLING**2)
    return Image.fromarray(np.round(255 * np.minimum(pixels, 1)).astype(np.uint8), "RGBA")
