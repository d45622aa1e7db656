"""Thumbnails: small pictures of a body, from the side where most of the body is seen."""

from __future__ import annotations

from io import BytesIO

import numpy as np
from PIL import Image

from pcretrieve.arrays import FloatArray, IntArray
from pcretrieve.errors import DegenerateMeshError, OptionError
from pcretrieve.rendering.camera import (
    MARGIN,
    SUPERSAMPLING,
    body_axes,
    pooled,
    rotation,
    views_around,
    visible_faces,
)
from pcretrieve.rendering.pictures import point_picture
from pcretrieve.rendering.shading import CLAY, face_brightness

__all__ = ["cloud_thumbnail", "thumbnail"]

# A palette makes a picture a third as large: with nothing, and each brightness at each coverage, the palette
# holds what 8 bits can number. No eye tells 63 levels of one colour from more.
N_COVERAGES = SUPERSAMPLING**2
N_LEVELS = 255 // N_COVERAGES

# Points of a cloud that its thumbnail shows; more cannot be told apart.
MOST_POINTS = 20_000

# Brightness of the points farthest from the viewer; the nearest have 1.
DARKEST = 0.35


def thumbnail(
    vertices: FloatArray,
    faces: IntArray,
    *,
    size: int = 160,
    azimuth: float = 20.0,
    elevation: float = 10.0,
) -> bytes:
    """A picture of a surface, from a side where much of the surface is seen.

    Orthographic, two-sided, lit by two lamps; the body touches the frame less `MARGIN`. The view is that of
    `body_axes`, so where the body lies, how large it is and how it is turned do not change its picture.

    Parameters
    ----------
    vertices : (n, 3) float64
        Vertices of the surface, in any unit.
    faces : (m, 3) int32
        Vertex numbers of the triangles.
    size : int, default 160
        Side of the square picture; pixels.
    azimuth, elevation : float, default 20 and 10
        How far to the right of and above the front of `body_axes` the viewer stands, so that the body has
        depth; degrees.

    Returns
    -------
    bytes
        PNG with a palette, transparent where nothing is; 4 to 7 kB at 160 pixels.

    Raises
    ------
    DegenerateMeshError
        For a surface without area.
    OptionError
        For a size below 1, or angles that are not finite.
    """
    if size < 1:
        raise OptionError(f"size must be at least 1 pixel, got {size}")
    if not np.isfinite([azimuth, elevation]).all():
        raise OptionError(f"azimuth and elevation must be finite degrees, got {azimuth} and {elevation}")
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0))) if len(vertices) else 0.0
    # Rays are cast in single precision, and meet nothing thinner.
    if not area > np.finfo(np.float32).eps * diagonal**2:
        raise DegenerateMeshError(
            f"a surface must have area to be drawn, got {len(faces)} faces with an area of {area:.3g}; leave "
            "its picture out",
            stage="thumbnail",
        )
    framed = _framed(vertices @ (rotation(azimuth, elevation) @ body_axes(vertices, faces)).T, faces)
    face = visible_faces(framed, faces, size)
    covered = (face >= 0).astype(np.float64)
    return _png(np.append(face_brightness(framed, faces), 0.0)[face], covered)


def cloud_thumbnail(points: FloatArray, *, size: int = 160) -> bytes:
    """A picture of a point cloud, nearer points brighter, from a side where much of the cloud is seen.

    Parameters
    ----------
    points : (n, 3) float64
        At least one point.
    size : int, default 160
        Side of the square picture; pixels.

    Returns
    -------
    bytes
        PNG, transparent where nothing is.
    """
    shown = points[:: -(-len(points) // MOST_POINTS)]
    view = views_around(shown)[0]
    depth = view.seen(shown)[:, 2:]  # (n, 1)
    bright = DARKEST + (1 - DARKEST) * (np.clip(depth, -1, 1) + 1) / 2
    spacing = 2 * view.half / np.sqrt(len(shown))
    file = BytesIO()
    point_picture(shown, bright * CLAY, view, width=spacing, size=size).save(file, "PNG", optimize=True)
    return file.getvalue()


def _framed(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """(n, 3) vertices moved and scaled so that the surface fills [-1, 1]² less the margin, below z = 0."""
    used = vertices[faces.ravel()]
    low, high = used.min(axis=0), used.max(axis=0)
    centre = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, high[2]]
    framed: FloatArray = (vertices - centre) * (2 - 4 * MARGIN) / (high - low)[:2].max()
    return framed


def _png(shade: FloatArray, covered: FloatArray) -> bytes:
    """Rays pooled to pixels and encoded; `shade` is 0 where `covered` is."""
    coverage = pooled(covered)
    # The mean over the rays that hit, so that edges do not darken.
    brightness = pooled(shade) / np.where(coverage > 0, coverage, 1)
    step = np.round(coverage * N_COVERAGES)
    level = np.round(brightness * (N_LEVELS - 1))
    number = np.where(step > 0, 1 + (step - 1) * N_LEVELS + level, 0)  # (size, size), row of the palette

    levels = np.linspace(0, 255, N_LEVELS)[:, np.newaxis] * CLAY  # (N_LEVELS, 3)
    colours = np.concatenate([np.zeros((1, 3)), np.tile(levels, (N_COVERAGES, 1))])
    alphas = np.concatenate([[0], np.repeat(np.linspace(0, 255, N_COVERAGES + 1)[1:], N_LEVELS)])
    picture = Image.fromarray(number.astype(np.uint8))
    picture.putpalette(np.round(colours).astype(np.uint8).tobytes())
    file = BytesIO()
    picture.save(file, "PNG", transparency=np.round(alphas).astype(np.uint8).tobytes())
    return file.getvalue()
