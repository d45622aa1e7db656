"""Thumbnails: a shaded picture of a surface, cast ray by ray, so that no display is needed."""

from __future__ import annotations

from io import BytesIO

import numpy as np
from PIL import Image

from pcretrieve.adapters.open3d import RayScene
from pcretrieve.errors import DegenerateMeshError, OptionError
from pcretrieve.types import FloatArray, IntArray, TriangleMesh

__all__ = ["MARGIN", "body_axes", "thumbnail"]

#: Left free on each side of a picture; a share of its width.
MARGIN = 0.04

# Rays per pixel along each side: five levels of coverage make an edge smooth.
SUPERSAMPLING = 2

# A palette makes a picture a third as large: with nothing, and each brightness at each coverage, it holds
# what 8 bits can number. No eye tells 63 levels of one colour from more.
N_COVERAGES = SUPERSAMPLING**2
N_LEVELS = 255 // N_COVERAGES

# A light clay, which stands out from white pages and from black ones; sRGB in [0, 1].
CLAY = (0.86, 0.80, 0.74)

# Directions to the two lamps as seen by the viewer (right, up, towards), and how strong they are: a key from
# the upper left, as in drawings, and a weak fill from the right so that no side is black.
LIGHTS = (((-0.5, 0.7, 0.8), 0.72), ((0.9, 0.1, 0.5), 0.22))
AMBIENT = 0.26

# Decides by the file's axes where the shape has no preference, as a sphere has none. Share of the total
# variance, and also a skewness: far above rounding, far below what can be seen.
TIE = 1e-6


def thumbnail(
    mesh: TriangleMesh, *, size: int = 160, azimuth: float = 20.0, elevation: float = 10.0
) -> bytes:
    """A picture of a surface, from a side where much of it is seen.

    Orthographic, two-sided, lit by two lamps; the body touches the frame less `MARGIN`. The view is that of
    `body_axes`, so where the body lies, how large it is and how it is turned do not change its picture.

    Parameters
    ----------
    mesh : TriangleMesh
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
    # Rays are cast in single precision, and meet nothing thinner.
    if not mesh.area > np.finfo(np.float32).eps * mesh.diagonal**2:
        raise DegenerateMeshError(
            f"a surface must have area to be drawn, got {len(mesh.faces)} faces with an area of "
            f"{mesh.area:.3g}; leave its picture out",
            stage="thumbnail",
        )
    to_viewer = _turn(azimuth, elevation) @ body_axes(mesh)
    shade, covered = _cast(_framed(mesh.vertices @ to_viewer.T, mesh.faces), mesh.faces, size * SUPERSAMPLING)
    return _png(shade, covered)


def body_axes(mesh: TriangleMesh) -> FloatArray:
    """Right, up and towards the viewer, by the principal axes of a surface: they turn with the body.

    The viewer looks along the axis of least variance. Up is the more skewed of the other two, against the
    skewness: bodies stand on limbs, which reach further from the trunk than the rest, whether the trunk is
    upright or level. Of front and back, the viewer sees the one for which the more skewed of the axes right
    and towards has positive skewness. Mirror images are not confused.

    Parameters
    ----------
    mesh : TriangleMesh
        With positive area.

    Returns
    -------
    (3, 3) float64
        Rows right, up and towards: orthonormal, right-handed. Where the shape leaves a choice, they are as
        near as can be to x, y and z.
    """
    corners = [mesh.vertices[mesh.faces[:, k]] for k in range(3)]
    # Midpoints of edges, with a third of the area each, integrate quadratics over a triangle exactly.
    points = np.concatenate([(corners[k - 1] + corners[k]) / 2 for k in range(3)])  # (3m, 3)
    weights = np.tile(mesh.face_areas, 3) / (3 * mesh.area)  # (3m,)
    points -= weights @ points
    points /= np.sqrt(weights @ (points**2).sum(axis=1))  # total variance 1
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


def _turn(azimuth: float, elevation: float) -> FloatArray:
    """(3, 3) rotation from body axes to those of a viewer who stands to the right and above; degrees."""
    a, e = np.radians([azimuth, elevation])
    right = np.array([np.cos(a), 0.0, -np.sin(a)])
    towards = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
    return np.stack([right, np.cross(towards, right), towards])


def _framed(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """(n, 3) vertices moved and scaled so that the surface fills [-1, 1]² less the margin, below z = 0."""
    used = vertices[faces.ravel()]
    low, high = used.min(axis=0), used.max(axis=0)
    centre = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, high[2]]
    framed: FloatArray = (vertices - centre) * (2 - 4 * MARGIN) / (high - low)[:2].max()
    return framed


def _cast(vertices: FloatArray, faces: IntArray, n: int) -> tuple[FloatArray, FloatArray]:
    """Brightness in [0, 1] and coverage, 0 or 1, of an (n, n) grid of rays over [-1, 1]², top row first."""
    ticks = (2 * np.arange(n) + 1) / n - 1
    x, y = np.meshgrid(ticks, -ticks)
    origins = np.stack([x.ravel(), y.ravel(), np.ones(n * n)], axis=1)  # (n², 3)
    directions = np.broadcast_to([0.0, 0.0, -1.0], origins.shape)
    _, normals, face = RayScene(vertices, faces).cast(origins, directions)
    covered = face >= 0
    facing = normals[covered]
    facing *= np.where(facing[:, 2:] < 0, -1, 1)  # both sides of a face look the same
    light = np.full(len(facing), AMBIENT)
    for direction, strength in LIGHTS:
        light += strength * np.maximum(facing @ direction / np.linalg.norm(direction), 0)  # Lambert's law
    shade = np.zeros(n * n)
    shade[covered] = np.minimum(light, 1)
    return shade.reshape(n, n), covered.astype(np.float64).reshape(n, n)


def _png(shade: FloatArray, covered: FloatArray) -> bytes:
    """Rays pooled to pixels and encoded; `shade` is 0 where `covered` is."""
    coverage = _pooled(covered)
    # The mean over the rays that hit, so that edges do not darken.
    brightness = _pooled(shade) / np.where(coverage > 0, coverage, 1)
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


def _pooled(rays: FloatArray) -> FloatArray:
    """Means over the rays of each pixel."""
    size = len(rays) // SUPERSAMPLING
    blocks = rays.reshape(size, SUPERSAMPLING, size, SUPERSAMPLING)
    pooled: FloatArray = blocks.mean(axis=(1, 3))
    return pooled
