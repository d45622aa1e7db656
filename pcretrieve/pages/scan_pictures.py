"""Pictures of points and surfaces in colours that mean something, cast ray by ray: no display is needed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from PIL import Image, ImageDraw

from pcretrieve.adapters.open3d import RayScene
from pcretrieve.pages.thumbnail import AMBIENT, LIGHTS, MARGIN, body_axes
from pcretrieve.types import FloatArray, IntArray, TriangleMesh

__all__ = ["Colour", "View", "point_picture", "rgb", "surface_picture", "views_of"]

#: Red, green and blue in [0, 1].
Colour = tuple[float, float, float]

# How far to the right of the front the viewer stands for each picture, and how far above; degrees.
AZIMUTHS = (20, 110, 200, 290)
ELEVATION = 15

# Too small to be seen; relative to the body.
SMALL = 1e-3

# Rays per pixel along each side.
SUPERSAMPLING = 2

# Points are drawn as squares at least this wide, so that none is lost; pixels. Few points with much between
# them are drawn no wider than this; half sides of the picture.
LEAST_WIDTH, LARGEST_WIDTH = 1.5, 0.05


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """From where a picture is taken, and what fits into it.

    Attributes
    ----------
    axes : (3, 3) float64
        Rows right, up and towards the viewer: orthonormal.
    centre : (3,) float64
        In the middle of the picture; unit of the scan.
    half : float
        Half the side of what the picture shows; unit of the scan.
    """

    axes: FloatArray
    centre: FloatArray
    half: float

    def seen(self, points: FloatArray) -> FloatArray:
        """(n, 3) points to the right of, above and before the middle; the picture shows [-1, 1]²."""
        seen: FloatArray = (points - self.centre) @ self.axes.T / self.half
        return seen


def views_of(points: FloatArray) -> list[View]:
    """Views of a body from four sides, all of one scale.

    Parameters
    ----------
    points : (n, 3) float64
        All over the body: what the pictures must show.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    size = float(np.linalg.norm(high - low)) or 1.0  # of equal points
    # The axes of a surface of small equal triangles, one at each point, are those of the points.
    corners = points[:, None] - points.mean(axis=0) + SMALL * size * np.eye(3)  # (n, 3, 3)
    numbers = np.arange(3 * len(points), dtype=np.int32).reshape(-1, 3)
    axes = body_axes(TriangleMesh(corners.reshape(-1, 3), numbers))
    views = []
    for azimuth in AZIMUTHS:
        a, e = np.radians([azimuth, ELEVATION])
        right = np.array([np.cos(a), 0, -np.sin(a)])
        towards = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
        view = View(np.stack([right, np.cross(towards, right), towards]) @ axes, np.zeros(3), 1.0)
        seen = view.seen(points)  # (n, 3)
        middle = (seen.min(axis=0) + seen.max(axis=0)) / 2
        views.append(replace(view, centre=middle @ view.axes, half=np.ptp(seen[:, :2], axis=0).max() / 2))
    widest = max(SMALL * size, *(view.half for view in views)) / (1 - 2 * MARGIN)
    return [replace(view, half=widest) for view in views]


def point_picture(
    points: FloatArray, colours: FloatArray, view: View, *, width: float, size: int
) -> Image.Image:
    """Points as squares that face the viewer.

    Parameters
    ----------
    points : (n, 3) float64
    colours : (n, 3) float64
        Red, green and blue in [0, 1].
    view : View
    width : float
        Of a square, within limits; unit of the scan.
    size : int
        Side of the picture; pixels.
    """
    half = max(min(width / view.half, LARGEST_WIDTH), 2 * LEAST_WIDTH / size) / 2
    corners = half * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    vertices = (view.seen(points)[:, None] + corners).reshape(-1, 3)  # (4n, 3)
    first = 4 * np.arange(len(points), dtype=np.int32)  # (n,)
    faces = np.concatenate(
        [np.column_stack([first, first + 1, first + 2]), np.column_stack([first, first + 2, first + 3])]
    )
    return _cast(vertices, faces, np.tile(colours, (2, 1)), size)


def surface_picture(
    mesh: TriangleMesh,
    colours: FloatArray,
    view: View,
    *,
    size: int,
    rings: Sequence[tuple[FloatArray, Colour]] = (),
) -> Image.Image:
    """A surface lit by the lamps of the thumbnails.

    Parameters
    ----------
    mesh : TriangleMesh
    colours : (m, 3) float64
        Of its faces.
    view : View
    size : int
        Side of the picture; pixels.
    rings : sequence of ((k, 3) positions, colour)
        Drawn round places on or in the surface, and seen through it.
    """
    vertices = view.seen(mesh.vertices)
    a, b, c = (vertices[mesh.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)  # (m, 3)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny)
    normals *= np.where(normals[:, 2:] < 0, -1, 1)  # both sides of a face look the same
    light = np.full(len(normals), AMBIENT)
    for direction, strength in LIGHTS:
        light += strength * np.maximum(normals @ direction / np.linalg.norm(direction), 0)
    picture = _cast(vertices, mesh.faces, colours * np.minimum(light, 1)[:, None], size)
    pen = ImageDraw.Draw(picture)
    radius = size / 45
    for positions, colour in rings:
        for x, y in (view.seen(positions)[:, :2] * [1, -1] + 1) * size / 2:
            box = (x - radius, y - radius, x + radius, y + radius)
            pen.ellipse(box, outline=rgb(colour), width=max(round(size / 140), 1))
    return picture


def rgb(colour: Colour) -> tuple[int, int, int]:
    """The colour in [0, 255]."""
    red, green, blue = (round(255 * part) for part in colour)
    return red, green, blue


def _cast(vertices: FloatArray, faces: IntArray, colours: FloatArray, size: int) -> Image.Image:
    """What (size, size) pixels see of [-1, 1]² from above, as a picture with a transparent background."""
    n = SUPERSAMPLING * size
    ticks = (2 * np.arange(n) + 1) / n - 1
    x, y = np.meshgrid(ticks, -ticks)
    top = vertices[:, 2].max(initial=0) + 1
    origins = np.column_stack([x.ravel(), y.ravel(), np.full(n * n, top)])  # (n², 3)
    _, _, face = RayScene(vertices, faces).cast(origins, np.broadcast_to([0.0, 0.0, -1.0], origins.shape))
    palette = np.concatenate([np.column_stack([colours, np.ones(len(colours))]), np.zeros((1, 4))])
    seen = palette[face]  # (n², 4); face -1, nothing, is the last
    pooled = seen.reshape(size, SUPERSAMPLING, size, SUPERSAMPLING, 4).mean(axis=(1, 3))
    # The mean over the rays that hit, so that edges do not darken.
    pooled[..., :3] /= np.maximum(pooled[..., 3:], 1 / SUPERSAMPLING**2)
    return Image.fromarray(np.round(255 * np.minimum(pooled, 1)).astype(np.uint8), "RGBA")
