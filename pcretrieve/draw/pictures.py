"""Pictures of points and surfaces by a virtual camera and two lamps, by ray casting; and thumbnails."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from io import BytesIO
from typing import NamedTuple

import numpy as np
from PIL import Image, ImageDraw

from pcretrieve.arrays import (
    FloatArray,
    IntArray,
    area_vectors,
    bounding_diagonal,
    unit_vectors,
)
from pcretrieve.arrays.open3d import RayScene
from pcretrieve.draw.axes import body_axes, principal_axes

#: Red, green and blue in [0, 1].
Colour = tuple[float, float, float]

#: The colour of surfaces: a light clay, visible on white and on black; sRGB in [0, 1].
CLAY = (0.86, 0.80, 0.74)

# Margin on each side of a picture, relative to its width. Smallest field of view, relative to the body.
MARGIN = 0.04
SMALL = 1e-3

# Number of rays along each side of a pixel, for antialiasing: four rays give five levels of coverage.
SUPERSAMPLING = 2

# Azimuths of the cameras around a body, to the right of its front, and their elevation; degrees.
AZIMUTHS = (20, 110, 200, 290)
ELEVATION = 15

# Directions to the two lamps in the frame of the camera (right, up, towards), and their strengths: a key
# light from the upper left, and a weak fill light from the right.
LIGHTS = (((-0.5, 0.7, 0.8), 0.72), ((0.9, 0.1, 0.5), 0.22))
AMBIENT = 0.26

# Brightness of the points farthest from the camera; the nearest have 1.
DARKEST = 0.35

# Limits of the side of the square of a point: the smallest in pixels, so that no point is lost; the largest
# relative to half of the side of the picture, for sparse points.
LEAST_WIDTH = 1.5
LARGEST_WIDTH = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """An orthographic camera.

    axes: (3, 3), orthonormal rows: the directions to the right, upwards, and towards the camera.
    centre: (3,), the point in the centre of the picture; unit of the scan.
    half: half of the side of the field of view; unit of the scan.
    """

    axes: FloatArray
    centre: FloatArray
    half: float

    def seen(self, points: FloatArray) -> FloatArray:
        """(n, 3) image coordinates, right, up and towards the camera; the field of view is [-1, 1]²."""
        return np.asarray((points - self.centre) @ self.axes.T / self.half)


def cameras_around(points: FloatArray, axes: FloatArray | None = None) -> list[Camera]:
    """Cameras on four sides of a body, in front of which `axes` are, with all points in the field of view."""
    axes = (
        principal_axes(points, np.full(len(points), 1 / len(points)))
        if axes is None
        else axes
    )
    return cameras_framing(
        points, [rotation(azimuth, ELEVATION) @ axes for azimuth in AZIMUTHS]
    )


def cameras_framing(points: FloatArray, directions: Iterable[FloatArray]) -> list[Camera]:
    """Cameras with given axes, with one scale and all points in the field of view."""
    # Equal points have the size 1.
    size = float(np.linalg.norm(np.ptp(points, axis=0))) or 1.0
    framed = []
    for axes in directions:
        seen = points @ axes.T  # (n, 3)
        low, high = seen.min(axis=0), seen.max(axis=0)
        framed.append(Camera(axes, (low + high) / 2 @ axes, (high - low)[:2].max() / 2))
    widest = max(SMALL * size, *(camera.half for camera in framed)) / (1 - 2 * MARGIN)
    return [Camera(camera.axes, camera.centre, widest) for camera in framed]


def rotation(azimuth: float, elevation: float) -> FloatArray:
    """The axes of a camera to the right of the front of a body, and above it, by degrees."""
    a, e = np.radians([azimuth, elevation])
    right = np.array([np.cos(a), 0.0, -np.sin(a)])
    towards = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
    return np.stack([right, np.cross(towards, right), towards])


def visible_faces(vertices: FloatArray, faces: IntArray, size: int) -> IntArray:
    """The first face on each ray of a camera.

    vertices: (n, 3), image coordinates; the rays are parallel to −z, in the field of view [-1, 1]².
    size: side of the picture; pixels.
    Returns (s, s): numbers of the faces, −1 for none; s is `size` times `SUPERSAMPLING`; the top row first.
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
    origins = np.column_stack(
        [x.ravel(), y.ravel(), np.full(x.size, max(top, 0) + 1)]
    )  # (k, 3)
    _, _, face = RayScene(vertices, faces).cast(
        origins, np.broadcast_to([0.0, 0.0, -1.0], origins.shape)
    )
    seen[rows, columns] = face.reshape(x.shape)
    return seen


def pooled(rays: FloatArray) -> FloatArray:
    """The means over the rays of each pixel, of values in the order of `visible_faces`."""
    size = len(rays) // SUPERSAMPLING
    blocks = rays.reshape(size, SUPERSAMPLING, size, SUPERSAMPLING, *rays.shape[2:])
    return np.asarray(blocks.mean(axis=(1, 3)))


def point_picture(
    points: FloatArray, colours: FloatArray, camera: Camera, *, width: float, size: int
) -> Image.Image:
    """A picture of points, drawn as squares that face the camera.

    colours: (n, 3), red, green and blue in [0, 1].
    width: side of a square, within limits; unit of the camera.
    size: side of the picture; pixels.
    """
    reach = max(min(width / camera.half, LARGEST_WIDTH), 2 * LEAST_WIDTH / size) / 2
    corners = reach * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    vertices = (camera.seen(points)[:, None] + corners).reshape(-1, 3)  # (4n, 3)
    first = 4 * np.arange(len(points), dtype=np.int32)[:, None]  # (n, 1)
    faces = np.concatenate(
        [first + np.array(half, np.int32) for half in ([0, 1, 2], [0, 2, 3])]
    )
    return _picture(vertices, faces, np.tile(colours, (2, 1)), size)


def depth_picture(
    points: FloatArray, colour: Colour, camera: Camera, *, width: float, size: int
) -> Image.Image:
    """A picture of points of one colour, which are darker at the far end."""
    bright = (
        DARKEST + (1 - DARKEST) * (np.clip(camera.seen(points)[:, 2:], -1, 1) + 1) / 2
    )  # (n, 1)
    return point_picture(points, bright * colour, camera, width=width, size=size)


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

    colours: (m, 3), colours of the faces; red, green and blue in [0, 1].
    size: side of the picture; pixels.
    rings: (k, 3) positions around which rings are drawn, also behind the surface, and their colour.
    """
    seen = camera.seen(vertices)
    picture = _picture(seen, faces, colours * face_brightness(seen, faces)[:, None], size)
    pen, radius = ImageDraw.Draw(picture), size / 45
    for positions, colour in rings:
        for x, y in (camera.seen(positions)[:, :2] * [1, -1] + 1) * size / 2:
            box = (x - radius, y - radius, x + radius, y + radius)
            pen.ellipse(box, outline=rgb(colour), width=max(round(size / 140), 1))
    return picture


def face_brightness(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """(m,) the brightness in [0, 1] of a matt surface by Lambert's law; both sides of a face look alike.

    vertices: (n, 3), coordinates in the frame of the camera: right, up, towards.
    """
    normals = unit_vectors(area_vectors(vertices, faces))  # (m, 3)
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


def _picture(
    vertices: FloatArray, faces: IntArray, colours: FloatArray, size: int
) -> Image.Image:
    """A picture of (size, size) pixels of the field of view [-1, 1]², with a transparent background."""
    palette = np.concatenate(
        [np.column_stack([colours, np.ones(len(colours))]), np.zeros((1, 4))]
    )
    # Face −1, none, is the last row.
    pixels = pooled(palette[visible_faces(vertices, faces, size)])
    # The mean over the rays that hit a face, so that edges are not darker.
    pixels[..., :3] /= np.maximum(pixels[..., 3:], 1 / SUPERSAMPLING**2)
    return Image.fromarray(np.round(255 * np.minimum(pixels, 1)).astype(np.uint8), "RGBA")


# --- thumbnails: small pictures of a body from its front ---------------------------------------------------

# Side of the pictures that catalogues keep, and from which smaller ones are made; pixels.
THUMBNAIL_PIXELS = 200

# Side of the pictures of clouds, pixels, and the largest number of points that are drawn.
CLOUD_PIXELS = 160
MOST_POINTS = 20_000

# Angles of the camera to the right of the front of a body, and above it; degrees.
THUMBNAIL_AZIMUTH = 20.0
THUMBNAIL_ELEVATION = 10.0


class Thumbnail(NamedTuple):
    """A picture of a surface.

    png: a PNG file with a palette and a transparent background; 4 to 7 kB at 200 pixels.
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
    (camera,) = cameras_framing(
        vertices[faces.ravel()], [rotation(THUMBNAIL_AZIMUTH, THUMBNAIL_ELEVATION) @ axes]
    )
    clay = np.tile(CLAY, (len(faces), 1))
    return Thumbnail(
        _png(surface_picture(vertices, faces, clay, camera, size=size)), axes[1]
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
    camera = cameras_around(shown)[0]
    spacing = 2 * camera.half / np.sqrt(len(shown))
    file = BytesIO()
    depth_picture(shown, CLAY, camera, width=spacing, size=CLOUD_PIXELS).save(
        file, "PNG", optimize=True
    )
    return file.getvalue()


def picture_html(picture: bytes | None, words: str) -> str:
    """A picture with words below it, for notebooks."""
    address = f"data:image/png;base64,{b64encode(picture or b'').decode('ascii')}"
    image = "" if picture is None else f'<img alt="" src="{address}"><br>'
    return f"<div style='display: inline-block'>{image}<code>{escape(words)}</code></div>"


def _png(picture: Image.Image) -> bytes:
    """A PNG file with a palette, which reduces the size of a file to a third."""
    file = BytesIO()
    picture.quantize().save(file, "PNG")
    return file.getvalue()
