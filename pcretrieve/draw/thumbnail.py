"""Thumbnails: small pictures of a body from its front."""

from __future__ import annotations

from base64 import b64encode
from html import escape
from io import BytesIO
from typing import NamedTuple

import numpy as np
from PIL import Image

from pcretrieve.arrays import FloatArray, IntArray, area_vectors, bounding_diagonal
from pcretrieve.draw import pictures
from pcretrieve.draw.axes import body_axes

# Side of the pictures that catalogues keep, and from which smaller ones are made; pixels.
THUMBNAIL_PIXELS = 200

# Side of the pictures of clouds, pixels, and the largest number of points that are drawn.
CLOUD_PIXELS = 160
MOST_POINTS = 20_000

# Angles of the camera to the right of the front of a body, and above it; degrees.
AZIMUTH = 20.0
ELEVATION = 10.0

# The palette has one entry for the background, and one for each brightness at each coverage, at most 256 in
# all. It reduces the size of a file to a third.
N_COVERAGES = pictures.SUPERSAMPLING**2
N_LEVELS = 255 // N_COVERAGES


class Thumbnail(NamedTuple):
    """A picture of a surface.

    png: a PNG file with a palette and a transparent background; 6 to 10 kB at 200 pixels.
    up: (3,) float64, the direction that is upwards in it, in the frame of the surface; of length 1.
    """

    png: bytes
    up: FloatArray


def thumbnail(
    vertices: FloatArray,
    faces: IntArray,
    *,
    up: FloatArray | None = None,
    size: int = THUMBNAIL_PIXELS,
) -> Thumbnail | None:
    """A picture of a surface from its front, which fills the picture up to `MARGIN`; None without area.

    It is invariant to rigid motion and scaling of the body, because the camera is relative to `body_axes`.

    up: (3,), optional, the direction upwards, such as `TriangleMesh.up`, of length 1.
    size: side of the square picture; pixels.
    """
    area = float(np.linalg.norm(area_vectors(vertices, faces), axis=1).sum())
    # Rays are cast in single precision, and do not hit thinner surfaces.
    if (
        not len(faces)
        or not area > np.finfo(np.float32).eps * bounding_diagonal(vertices) ** 2
    ):
        return None
    axes = body_axes(vertices, faces, up)
    (camera,) = pictures.cameras_framing(
        vertices[faces.ravel()], [pictures.rotation(AZIMUTH, ELEVATION) @ axes]
    )
    clay = np.tile(pictures.CLAY, (len(faces), 1))
    return Thumbnail(
        _png(pictures.surface_picture(vertices, faces, clay, camera, size=size)), axes[1]
    )


def resized(picture: bytes, size: int) -> bytes:
    """A smaller thumbnail, with sides of `size` pixels."""
    with Image.open(BytesIO(picture)) as image:
        if image.width <= size:
            return picture
        return _png(image.convert("RGBA").resize((size, size), Image.Resampling.BOX))


def cloud_thumbnail(points: FloatArray) -> bytes:
    """A picture of at least one point from the front of the cloud; nearer points are brighter."""
    shown = points[:: -(-len(points) // MOST_POINTS)]
    camera = pictures.cameras_around(shown)[0]
    spacing = 2 * camera.half / np.sqrt(len(shown))
    file = BytesIO()
    pictures.depth_picture(
        shown, pictures.CLAY, camera, width=spacing, size=CLOUD_PIXELS
    ).save(file, "PNG", optimize=True)
    return file.getvalue()


def picture_html(picture: bytes | None, words: str) -> str:
    """A picture with words below it, for notebooks."""
    address = f"data:image/png;base64,{b64encode(picture or b'').decode('ascii')}"
    image = "" if picture is None else f'<img alt="" src="{address}"><br>'
    return f"<div style='display: inline-block'>{image}<code>{escape(words)}</code></div>"


def _png(picture: Image.Image) -> bytes:
    """A PNG file of a picture in shades of clay."""
    red, _, _, opacity = np.moveaxis(np.asarray(picture) / 255, 2, 0)
    step = np.round(opacity * N_COVERAGES)
    level = np.round(np.minimum(red / pictures.CLAY[0], 1) * (N_LEVELS - 1))
    number = np.where(
        step > 0, 1 + (step - 1) * N_LEVELS + level, 0
    )  # (size, size), row of the palette
    levels = np.linspace(0, 255, N_LEVELS)[:, np.newaxis] * pictures.CLAY  # (N_LEVELS, 3)
    colours = np.concatenate([np.zeros((1, 3)), np.tile(levels, (N_COVERAGES, 1))])
    alphas = np.concatenate(
        [[0], np.repeat(np.linspace(0, 255, N_COVERAGES + 1)[1:], N_LEVELS)]
    )
    paletted = Image.fromarray(number.astype(np.uint8))
    paletted.putpalette(np.round(colours).astype(np.uint8).tobytes())
    file, transparency = BytesIO(), np.round(alphas).astype(np.uint8).tobytes()
    paletted.save(file, "PNG", transparency=transparency)
    return file.getvalue()
