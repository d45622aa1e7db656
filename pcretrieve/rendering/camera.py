"""The virtual camera: where the viewer stands, and which face each ray meets first.

The projection is orthographic: all rays are parallel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pcretrieve.adapters.open3d import RayScene
from pcretrieve.arrays import FloatArray, IntArray

__all__ = [
    "MARGIN",
    "SUPERSAMPLING",
    "View",
    "body_axes",
    "pooled",
    "principal_axes",
    "rotation",
    "views_around",
    "visible_faces",
]

#: Left free on each side of a picture; a share of its width.
MARGIN = 0.04

#: Rays per pixel along each side: five levels of coverage make an edge smooth.
SUPERSAMPLING = 2

# Decides by the axes of the file where the shape has no preference, as a sphere has none. Share of the total
# variance, and also a skewness: far above rounding, far below what can be seen.
TIE = 1e-6

# How far to the right of the front the viewer stands for each picture of a body, and how far above; degrees.
AZIMUTHS = (20, 110, 200, 290)
ELEVATION = 15

# A body smaller than this share of its picture cannot be seen.
SMALL = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """From where a picture is taken, and what fits into the picture.

    Attributes
    ----------
    axes : (3, 3) float64
        Rows right, up and towards the viewer: orthonormal.
    centre : (3,) float64
        The point in the middle of the picture; unit of the scan.
    half : float
        Half the side of what the picture shows; unit of the scan.
    """

    axes: FloatArray
    centre: FloatArray
    half: float

    def seen(self, points: FloatArray) -> FloatArray:
        """(n, 3) coordinates to the right of, above and before the middle; the picture shows [-1, 1]²."""
        seen: FloatArray = (points - self.centre) @ self.axes.T / self.half
        return seen


def views_around(points: FloatArray) -> list[View]:
    """Views of a body from four sides, all of one scale.

    Parameters
    ----------
    points : (n, 3) float64
        All over the body: what the pictures must show.

    Returns
    -------
    list of View
    """
    low, high = points.min(axis=0), points.max(axis=0)
    size = float(np.linalg.norm(high - low)) or 1.0  # the size of equal points
    axes = principal_axes(points, np.full(len(points), 1 / len(points)))
    views = []
    for azimuth in AZIMUTHS:
        view = View(rotation(azimuth, ELEVATION) @ axes, np.zeros(3), 1.0)
        seen = view.seen(points)  # (n, 3)
        middle = (seen.min(axis=0) + seen.max(axis=0)) / 2
        views.append(replace(view, centre=middle @ view.axes, half=np.ptp(seen[:, :2], axis=0).max() / 2))
    widest = max(SMALL * size, *(view.half for view in views)) / (1 - 2 * MARGIN)
    return [replace(view, half=widest) for view in views]


def body_axes(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Right, up and towards the viewer, by the principal axes of a surface: they turn with the body.

    Parameters
    ----------
    vertices : (n, 3) float64
        Vertices of the surface, in any unit.
    faces : (m, 3) int32
        Of positive total area.

    Returns
    -------
    (3, 3) float64
        As `principal_axes`.
    """
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2  # (m,)
    # The midpoints of the edges, each with a third of the area, integrate quadratics over a triangle exactly.
    points = np.concatenate([(c + a) / 2, (a + b) / 2, (b + c) / 2])  # (3m, 3)
    return principal_axes(points, np.tile(areas, 3) / (3 * areas.sum()))


def principal_axes(points: FloatArray, weights: FloatArray) -> FloatArray:
    """Right, up and towards the viewer, by the principal axes of weighted points.

    The viewer looks along the axis of least variance. Up is the more skewed of the other two axes, against
    the skew: a body with a head and legs stands on its legs.

    Parameters
    ----------
    points : (n, 3) float64
        In the unit of the view.
    weights : (n,) float64
        Their sum is 1.

    Returns
    -------
    (3, 3) float64
        Rows right, up and towards: orthonormal, right-handed. Where the shape leaves a choice, the axes are
        as near as can be to x, y and z.
    """
    points = points - weights @ points
    variance = weights @ (points**2).sum(axis=1)
    points = points / np.sqrt(variance if variance > 0 else 1.0)  # total variance 1
    covariance = (weights[:, np.newaxis] * points).T @ points  # (3, 3)

    def skewness(axis: FloatArray) -> float:
        along = points @ axis
        squares = along * along
        return float(weights @ (squares * along) / np.maximum(weights @ squares, TIE) ** 1.5)

    towards, middle, longest = np.linalg.eigh(covariance + TIE * np.diag([1.0, 2.0, 0.0]))[1].T
    up = longest if abs(skewness(longest)) + TIE >= abs(skewness(middle)) else middle
    if skewness(up) > TIE * up[1]:
        up = -up
    right = np.cross(up, towards)
    sides = skewness(right) + TIE * right[0], skewness(towards) + TIE * towards[2]
    if max(sides, key=abs) < 0:
        right, towards = -right, -towards
    return np.stack([right, up, towards])


def rotation(azimuth: float, elevation: float) -> FloatArray:
    """The turn from the axes of a body to those of a viewer who stands to the right and above.

    Parameters
    ----------
    azimuth, elevation : float
        How far to the right of the front and above the viewer stands; degrees.

    Returns
    -------
    (3, 3) float64
        Rotation matrix.
    """
    a, e = np.radians([azimuth, elevation])
    right = np.array([np.cos(a), 0.0, -np.sin(a)])
    towards = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
    return np.stack([right, np.cross(towards, right), towards])


def visible_faces(vertices: FloatArray, faces: IntArray, size: int) -> IntArray:
    """The face that each ray meets first.

    Parameters
    ----------
    vertices : (n, 3) float64
        In the frame of the picture, which shows [-1, 1]² from above (along −z).
    faces : (m, 3) int32
        Vertex numbers of the triangles.
    size : int
        Side of the picture; pixels.

    Returns
    -------
    (s, s) int32
        Numbers of faces, −1 where nothing is; s is `size` times `SUPERSAMPLING`, the top row first.
    """
    n = SUPERSAMPLING * size
    ticks = (2 * np.arange(n) + 1) / n - 1
    x, y = np.meshgrid(ticks, -ticks)
    top = vertices[:, 2].max(initial=0) + 1
    origins = np.column_stack([x.ravel(), y.ravel(), np.full(n * n, top)])  # (n², 3)
    _, _, face = RayScene(vertices, faces).cast(origins, np.broadcast_to([0.0, 0.0, -1.0], origins.shape))
    return face.reshape(n, n)


def pooled(rays: FloatArray) -> FloatArray:
    """Means over the rays of each pixel.

    Parameters
    ----------
    rays : (s, s, ...) float64
        One value a ray, as from `visible_faces`.

    Returns
    -------
    (s / `SUPERSAMPLING`, s / `SUPERSAMPLING`, ...) float64
        One value a pixel.
    """
    size = len(rays) // SUPERSAMPLING
    blocks = rays.reshape(size, SUPERSAMPLING, size, SUPERSAMPLING, *rays.shape[2:])
    means: FloatArray = blocks.mean(axis=(1, 3))
    return means
