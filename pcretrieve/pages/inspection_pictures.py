"""Pictures of one inspected scan, in rows of one layer from all sides, with defects marked by colours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from pcretrieve.checks import Inspection
from pcretrieve.draw import (
    CLAY,
    DARKEST,
    Camera,
    Colour,
    cameras_around,
    cameras_framing,
    depth_picture,
    point_picture,
    rgb,
    surface_picture,
)
from pcretrieve.values import FloatArray, PointCloud, TriangleMesh

if TYPE_CHECKING:
    from pcretrieve import Inspection

PICTURE_PIXELS = 280

# Number of colours in a picture: a third of the size of the file with all colours, without a visible
# difference.
N_COLOURS = 128

# Largest number of points in a picture and in the 3D viewer. With more points, the page would be larger than
# 5 MB, without a visible difference.
MOST_POINTS = 45_000

# sRGB colours in [0, 1], with contrast to white and to black: blue is right and orange is wrong, which
# colour-blind readers can distinguish.
KEPT = (0.42, 0.55, 0.70)
CUT_AWAY = (0.93, 0.69, 0.13)
DROPPED = (0.86, 0.10, 0.42)
FACING = (0.24, 0.50, 0.82)
AWAY = (0.95, 0.52, 0.10)
FILLED = (0.95, 0.52, 0.10)
CUT = (0.80, 0.05, 0.15)
BRIDGE = (0.45, 0.15, 0.75)

# The outline, in pictures of all points, of what the other pictures show.
FRAME = (0.50, 0.50, 0.50)

# Opacity of points that were removed, and least width of their squares, in fields of view. There are few of
# them, which should be seen, and what is behind them too.
REMOVED_OPACITY = 0.6
REMOVED_WIDTH = 0.007

# Largest distance from the body at which removed points are shown where they are, in diagonals of the body.
# Background may be so far away that the body would be a dot.
AROUND = 1.0

# Width of the squares of points, in median distances between nearest neighbours. Squares of this width
# overlap, and hide the points behind them.
SKIN_WIDTH = 3.5


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """Pictures of one layer from all sides, cropped above and below, and the meaning of each colour."""

    title: str
    key: list[tuple[Colour, str]]
    pictures: list[Image.Image]

    def __post_init__(self) -> None:
        boxes = [box for picture in self.pictures if (box := picture.getbbox())]
        top, bottom = min((box[1] for box in boxes), default=0), max((box[3] for box in boxes), default=1)
        cut = [picture.crop((0, top, picture.width, bottom)) for picture in self.pictures]
        object.__setattr__(self, "pictures", cut)

    def encoded(self) -> dict[str, object]:
        """The row for the template of the page: colours as CSS, pictures as PNG with a palette."""
        files = []
        for picture in self.pictures:
            file = BytesIO()
            picture.quantize(N_COLOURS).save(file, "PNG", optimize=True)
            files.append(file.getvalue())
        return {"title": self.title, "key": self.key, "pictures": files}


def inspection_cameras(it: Inspection) -> list[Camera]:
    """The cameras of all pictures of an inspection."""
    return cameras_around(it.body) if len(it.body) else []


def rows_of(it: Inspection) -> list[Row]:
    """The rows of pictures of an inspection."""
    rows = []
    if it.scan is not None and inspection_cameras(it):
        if it.cut_away.any() or _outside(it.scan.points[it.dropped], inspection_cameras(it)).any():
            rows.append(_overview_row(it.scan, it))
        rows.append(_raw_row(it.scan, it))
    if it.cloud is not None and it.cloud.normals is not None:
        rows.append(_normals_row(it.cloud, it.cloud.normals, it))
    if it.mesh is not None:
        clay = np.tile(CLAY, (len(it.mesh.faces), 1))
        plain = [
            surface_picture(it.mesh.vertices, it.mesh.faces, clay, camera, size=PICTURE_PIXELS)
            for camera in inspection_cameras(it)
        ]
        rows.append(Row("Surface", [(CLAY, f"{len(it.mesh.faces):,} faces")], plain))
    if it.mesh is not None and it.cloud is not None:
        rows.append(_marks_row(it.mesh, it))
    return rows


def _overview_row(scan: PointCloud, it: Inspection) -> Row:
    """All points; those too far away are at the edge of each picture, in their direction."""
    low, high = it.body.min(axis=0), it.body.max(axis=0)
    margin = AROUND * np.linalg.norm(high - low)
    near = ((scan.points >= low - margin) & (scan.points <= high + margin)).all(axis=1)
    close = inspection_cameras(it)
    kept = thinned(scan.points[~(it.dropped | it.cut_away)])
    corners = [
        body.centre + body.half * np.array(corner) @ body.axes[:2]
        for body in close
        for corner in ((-1, -1), (-1, 1), (1, -1), (1, 1))
    ]
    pictures = []
    cameras = cameras_framing(np.concatenate([scan.points[near], corners]), [one.axes for one in close])
    for camera, body in zip(cameras, close, strict=True):
        picture = Image.new("RGBA", (PICTURE_PIXELS, PICTURE_PIXELS))
        for points, colour in ((scan.points[it.cut_away], CUT_AWAY), (scan.points[it.dropped], DROPPED)):
            seen = camera.seen(thinned(points))[:, :2]  # (k, 2)
            seen /= np.maximum(abs(seen).max(axis=1, keepdims=True) / (1 - REMOVED_WIDTH), 1)
            at_edge = camera.centre + camera.half * seen @ camera.axes[:2]
            picture.alpha_composite(_removed(at_edge, colour, camera, it))
        picture.alpha_composite(_shaded(kept, KEPT, camera, it))
        pen = ImageDraw.Draw(picture)
        across, up = camera.seen(body.centre[None])[0, :2]
        x, y, half = across + 1, 1 - up, body.half / camera.half
        box = [PICTURE_PIXELS / 2 * part for part in (x - half, y - half, x + half, y + half)]
        pen.rectangle(box, outline=rgb(FRAME))
        pictures.append(picture)
    n, n_cut, n_far = int(it.dropped.sum()), int(it.cut_away.sum()), int((~near).sum())
    key = [(KEPT, f"{len(scan.points) - n - n_cut:,} points")]
    key += [(CUT_AWAY, f"{n_cut:,} cut away")] if n_cut else []
    key += [(DROPPED, f"{n:,} dropped as outliers")] if n else []
    key.append((FRAME, "frame of the pictures below"))
    far = f", {n_far:,} of them at the edge, because they are too far away" if n_far else ""
    return Row(f"All points that were read{far}", key, pictures)


def _raw_row(scan: PointCloud, it: Inspection) -> Row:
    kept, dropped = thinned(scan.points[~(it.dropped | it.cut_away)]), scan.points[it.dropped]
    pictures = []
    for camera in inspection_cameras(it):
        beside = _removed(thinned(dropped), DROPPED, camera, it)
        pictures.append(Image.alpha_composite(_shaded(kept, KEPT, camera, it), beside))
    n, n_cut = len(dropped), int(it.cut_away.sum())
    n_outside = int(_outside(dropped, inspection_cameras(it)).sum())
    beyond = f", {n_outside:,} of them beyond an edge in some pictures" if n_outside else ""
    words = f"{n:,} dropped as outliers{beyond}"
    key = [(KEPT, f"{len(scan.points) - n - n_cut:,} points"), (DROPPED, words)]
    return Row("Points of the body", key, pictures)


def _outside(points: FloatArray, cameras: Sequence[Camera]) -> NDArray[np.bool_]:
    """Whether each point is not in the field of view of one of the cameras, (n,)."""
    outside = np.zeros(len(points), dtype=np.bool_)
    for camera in cameras:
        outside |= (abs(camera.seen(points)[:, :2]) > 1).any(axis=1)
    return outside


def _shaded(points: FloatArray, colour: Colour, camera: Camera, it: Inspection) -> Image.Image:
    """Points that are darker at the far end."""
    width = SKIN_WIDTH / 2 * it.spacing
    return depth_picture(points, colour, camera, width=width, size=PICTURE_PIXELS)


def _removed(points: FloatArray, colour: Colour, camera: Camera, it: Inspection) -> Image.Image:
    """Small translucent points."""
    width = max(SKIN_WIDTH / 2 * it.spacing, 2 * REMOVED_WIDTH * camera.half)
    colours = np.tile(colour, (len(points), 1))
    picture = point_picture(points, colours, camera, width=width, size=PICTURE_PIXELS)
    picture.putalpha(picture.getchannel("A").point(lambda opacity: round(REMOVED_OPACITY * opacity)))
    return picture


def _normals_row(cloud: PointCloud, normals: FloatArray, it: Inspection) -> Row:
    pictures = []
    for camera in inspection_cameras(it):
        facing = normals @ camera.axes[2]  # (n,)
        colours = (
            np.where(facing[:, None] > 0, FACING, AWAY) * (DARKEST + (1 - DARKEST) * abs(facing))[:, None]
        )
        picture = point_picture(
            cloud.points, colours, camera, width=SKIN_WIDTH * it.spacing, size=PICTURE_PIXELS
        )
        pictures.append(picture)
    key = [(FACING, "outside faces you"), (AWAY, "inside faces you: a hole, or normals that point inwards")]
    return Row("Which side is outside", key, pictures)


def _marks_row(mesh: TriangleMesh, it: Inspection) -> Row:
    colours = np.where(it.filled[:, None], FILLED, CLAY)
    rings = [(it.cuts, CUT), (it.bridges, BRIDGE)]
    pictures = [
        surface_picture(mesh.vertices, mesh.faces, colours, camera, size=PICTURE_PIXELS, rings=rings)
        for camera in inspection_cameras(it)
    ]
    shares = [
        f"{check.name.lower()} {check.shown}"
        for check in it.checks
        if check.name in ("Filled in", "Closed base")
    ]
    key = [
        (FILLED, f"no point nearby: {', '.join(shares)}"),
        (CUT, f"cuts: {len(it.cuts)}"),
        (BRIDGE, f"bridges: {len(it.bridges)}"),
    ]
    return Row("What was filled in, cut and bridged", key, pictures)


def thinned(points: FloatArray) -> FloatArray:
    """`MOST_POINTS` of (n, 3) points at equal intervals in the order of the file; all if there are fewer."""
    return points[np.linspace(0, len(points) - 1, min(len(points), MOST_POINTS)).astype(np.intp)]
