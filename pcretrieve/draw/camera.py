"""The virtual camera, with an orthographic projection: its poses around a body, and the visible faces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pcretrieve.arrays import FloatArray, IntArray
from pcretrieve.draw.axes import principal_axes
from pcretrieve.draw.open3d import RayScene

#: Margin on each side of a picture, relative to its width.
MARGIN = 0.04

#: Number of rays along each side of a pixel, for antialiasing: four rays give five levels of coverage.
SUPERSAMPLING = 2

# Azimuths of the cameras around a body, to the right of its front, and their elevation; degrees.
AZIMUTHS = (20, 110, 200, 290)
ELEVATION = 15

# Smallest size of the field of view, relative to the size of the body.
SMALL = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """An orthographic camera.

    axes: (3, 3) float64, orthonormal rows: the directions to the right, upwards, and towards the camera.
    centre: (3,) float64, the point in the centre of the picture; unit of the scan.
    half: half of the side of the field of view; unit of the scan.
    """

    axes: FloatArray
    centre: FloatArray
    half: float

    def seen(self, points: FloatArray) -> FloatArray:
        """(n, 3) image coordinates, right, up and towards the camera; the field of view is [-1, 1]²."""
        seen: FloatArray = (points - self.centre) @ self.axes.T / self.half
        return seen


def cameras_around(points: FloatArray) -> list[Camera]:
    """Cameras on four sides of a body, with one scale.

    points: (n, 3) float64, all of which are in the field of view.
    """
    axes = principal_axes(points, np.full(len(points), 1 / len(points)))
    turned = [rotation(azimuth, ELEVATION) @ axes for azimuth in AZIMUTHS]
    return cameras_framing(points, [Camera(axes, np.zeros(3), 1.0) for axes in turned])


def cameras_framing(points: FloatArray, cameras: Sequence[Camera]) -> list[Camera]:
    """Cameras in given directions, with one scale.

    points: (n, 3) float64, all of which are in the field of view.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    size = float(np.linalg.norm(high - low)) or 1.0  # the size of equal points
    framed = []
    for camera in cameras:
        seen = points @ camera.axes.T  # (n, 3)
        middle = (seen.min(axis=0) + seen.max(axis=0)) / 2
        half = np.ptp(seen[:, :2], axis=0).max() / 2
        framed.append(replace(camera, centre=middle @ camera.axes, half=half))
    widest = max(SMALL * size, *(camera.half for camera in framed)) / (1 - 2 * MARGIN)
    return [replace(camera, half=widest) for camera in framed]


def rotation(azimuth: float, elevation: float) -> FloatArray:
    """The rotation from the axes of a body to those of a camera.

    azimuth, elevation: angles of the camera to the right of the front of the body, and above it; degrees.
    """
    a, e = np.radians([azimuth, elevation])
    right = np.array([np.cos(a), 0.0, -np.sin(a)])
    towards = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
    return np.stack([right, np.cross(towards, right), towards])


def visible_faces(vertices: FloatArray, faces: IntArray, size: int) -> IntArray:
    """The first face on each ray of a camera.

    vertices: (n, 3) float64, image coordinates; the rays are parallel to −z, in the field of view [-1, 1]².
    faces: (m, 3) int32, vertex numbers of the triangles.
    size: side of the picture; pixels.
    Returns (s, s) int32: numbers of the faces, −1 for none; s is `size` times `SUPERSAMPLING`, with the top
        row first.
    """
    n = SUPERSAMPLING * size
    ticks = (2 * np.arange(n) + 1) / n - 1
    seen = np.full((n, n), -1, np.int32)
    if not len(vertices):
        return seen
    # Rays beside the bounding box of the surface, which hit nothing, are not cast.
    (left, low, _), (right, high, top) = vertices.min(axis=0), vertices.max(axis=0)
    columns = slice(*np.searchsorted(ticks, [left, right]))
    rows = slice(*np.searchsorted(ticks, [-high, -low]))
    x, y = np.meshgrid(ticks[columns], -ticks[rows])
    origins = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, max(top, 0) + 1)])  # (k, 3)
    _, _, face = RayScene(vertices, faces).cast(origins, np.broadcast_to([0.0, 0.0, -1.0], origins.shape))
    seen[rows, columns] = face.reshape(x.shape)
    return seen


def pooled(rays: FloatArray) -> FloatArray:
    """The mean over the rays of each pixel.

    rays: (s, s, ...) float64, one value for each ray, in the order of `visible_faces`.
    Returns (s / `SUPERSAMPLING`, s / `SUPERSAMPLING`, ...) float64: one value for each pixel.
    """
    size = len(rays) // SUPERSAMPLING
    blocks = rays.reshape(size, SUPERSAMPLING, size, SUPERSAMPLING, *rays.shape[2:])
    means: FloatArray = blocks.mean(axis=(1, 3))
    return means
