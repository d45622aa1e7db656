"""Pictures of one inspected scan, in rows of one layer from all sides, with defects marked by colours."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from pcretrieve.atomic import write_file
from pcretrieve.inspection.inspection import Inspection
from pcretrieve.rendering import (
    CLAY,
    Camera,
    Colour,
    cameras_around,
    css,
    point_picture,
    rgb,
    surface_picture,
)
from pcretrieve.types import FloatArray, PointCloud, TriangleMesh

__all__ = [
    "AWAY",
    "BRIDGE",
    "CUT",
    "CUT_AWAY",
    "DROPPED",
    "FACING",
    "FILLED",
    "KEPT",
    "SKIN_WIDTH",
    "Row",
    "inspection_cameras",
    "rows_of",
    "thinned",
    "write_inspection_png",
]

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

# Width of the squares of dropped points, relative to the squares of other points. There are few of them, and
# they should be visible.
DROPPED_WIDTH = 2.5

# Largest distance from the body of points that were cut away and are shown, in diagonals of the body.
# Background may be so far away that the body would be a dot.
AROUND = 1.0

# Width of the squares of points, in median distances between nearest neighbours. Squares of this width
# overlap, and hide the points behind them.
SKIN_WIDTH = 3.5

# Smallest brightness. Points without normals are shaded by depth, from this brightness at the far end to 1 at
# the near end.
DARKEST = 0.35


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """Pictures of one layer from all sides, cropped above and below, and the meaning of their colours.

    Attributes
    ----------
    title : str
        What the pictures show.
    key : list of (Colour, str)
        The meaning of each colour.
    pictures : list of PIL.Image.Image
        One picture for each camera, with a transparent background.
    """

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
        key = [(css(colour), words) for colour, words in self.key]
        return {"title": self.title, "key": key, "pictures": files}


def inspection_cameras(it: Inspection) -> list[Camera]:
    """The cameras of all pictures of an inspection.

    Parameters
    ----------
    it : Inspection
        The inspection.

    Returns
    -------
    list of Camera
        Cameras on four sides of the body; empty if there are no points.
    """
    return cameras_around(it.body) if len(it.body) else []


def rows_of(it: Inspection) -> list[Row]:
    """The rows of pictures of an inspection.

    Parameters
    ----------
    it : Inspection
        The inspection.

    Returns
    -------
    list of Row
        Points that were cut away, if any were; raw points, normals, surface, and changes of the surface, as
        far as the stages did not fail.
    """
    rows = []
    if it.scan is not None and it.cut_away.any():
        rows.append(_cut_row(it.scan, it))
    if it.scan is not None and inspection_cameras(it):
        rows.append(_raw_row(it.scan, it))
    if it.cloud is not None and it.cloud.normals is not None:
        rows.append(_normals_row(it.cloud, it.cloud.normals, it))
    if it.mesh is not None:
        clay = np.tile(CLAY, (len(it.mesh.faces), 1))
        plain = [
            surface_picture(it.mesh.vertices, it.mesh.faces, clay, camera, size=PICTURE_PIXELS)
            for camera in inspection_cameras(it)
        ]
        rows.append(Row("Surface", [(CLAY, f"{len(it.mesh.faces)} faces")], plain))
    if it.mesh is not None and it.cloud is not None:
        rows.append(_marks_row(it.mesh, it))
    return rows


def _cut_row(scan: PointCloud, it: Inspection) -> Row:
    low, high = it.body.min(axis=0), it.body.max(axis=0)
    margin = AROUND * np.linalg.norm(high - low)
    near = ((scan.points >= low - margin) & (scan.points <= high + margin)).all(axis=1)
    points, cut = scan.points[near], it.cut_away[near]
    points, colours = thinned(points), thinned(np.where(cut[:, None], CUT_AWAY, KEPT))
    pictures = []
    for camera in cameras_around(points):
        depth = camera.seen(points)[:, 2:]
        bright = DARKEST + (1 - DARKEST) * (np.clip(depth, -1, 1) + 1) / 2  # (k, 1)
        width = max(SKIN_WIDTH / 2 * it.spacing, camera.half / 150)
        pictures.append(point_picture(points, bright * colours, camera, width=width, size=PICTURE_PIXELS))
    n, n_far = int(it.cut_away.sum()), int((it.cut_away & ~near).sum())
    words = f"{n} cut away" + (f", {n_far} of them too far away to be shown" if n_far else "")
    return Row("What was cut away", [(KEPT, f"{len(scan.points) - n} points"), (CUT_AWAY, words)], pictures)


def _raw_row(scan: PointCloud, it: Inspection) -> Row:
    kept = thinned(scan.points[~(it.dropped | it.cut_away)])
    dropped = thinned(scan.points[it.dropped])
    width = SKIN_WIDTH / 2 * it.spacing
    pictures = []
    for camera in inspection_cameras(it):
        depth = camera.seen(kept)[:, 2:]
        bright = DARKEST + (1 - DARKEST) * (np.clip(depth, -1, 1) + 1) / 2  # (n, 1)
        picture = point_picture(kept, bright * KEPT, camera, width=width, size=PICTURE_PIXELS)
        over = point_picture(
            dropped,
            np.tile(DROPPED, (len(dropped), 1)),
            camera,
            width=max(DROPPED_WIDTH * width, camera.half / 60),
            size=PICTURE_PIXELS,
        )
        pictures.append(Image.alpha_composite(picture, over))
    n, n_cut = int(it.dropped.sum()), int(it.cut_away.sum())
    key = [(KEPT, f"{len(scan.points) - n - n_cut} points"), (DROPPED, f"{n} dropped as outliers")]
    return Row("Points as they were read", key, pictures)


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
    key = [
        (FILLED, "filled in, no point nearby"),
        (CUT, f"cuts: {len(it.cuts)}"),
        (BRIDGE, f"bridges: {len(it.bridges)}"),
    ]
    return Row("What was filled in, cut and bridged", key, pictures)


def thinned(points: FloatArray) -> FloatArray:
    """Select `MOST_POINTS` points at equal intervals in the order of the file.

    Parameters
    ----------
    points : (n, 3) float64
        Points, or another value of each point.

    Returns
    -------
    (k, 3) float64
        All rows, if there are no more than `MOST_POINTS`.
    """
    return points[np.linspace(0, len(points) - 1, min(len(points), MOST_POINTS)).astype(np.intp)]


def write_inspection_png(inspection: Inspection, path: str | Path) -> Path:
    """Write the verdict and all pictures into one picture. An existing file is replaced in one step.

    Parameters
    ----------
    inspection : Inspection
        The result of `inspect_scan`.
    path : str or Path
        The PNG file, in a folder that exists.

    Returns
    -------
    Path
        Absolute path of the file.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    target = Path(path).absolute()
    rows = rows_of(inspection)
    margin, line, title = 16, 22, 34
    width = 2 * margin + len(inspection_cameras(inspection) or [0] * 4) * PICTURE_PIXELS
    lines = [check for check in inspection.checks if check.verdict != "passed"]
    height = 3 * margin + title + line * (1 + len(lines))
    height += sum(row.pictures[0].height + 2 * line + margin for row in rows)
    sheet = Image.new("RGB", (width, height), "white")
    pen = ImageDraw.Draw(sheet)

    def write(text: str, x: int, y: int, size: int, colour: Colour = (0.1, 0.1, 0.1)) -> None:
        font = ImageFont.load_default(size)
        while text and pen.textlength(text, font) > width - margin - x:
            text = text[:-2].rstrip("…") + "…" if len(text) > 2 else ""
        pen.text((x, y), text, rgb(colour), font)

    write(inspection.name, margin, margin, 24)
    y = margin + title
    write(inspection.summary, margin, y, 16, CUT if inspection.verdict == "failed" else (0.1, 0.1, 0.1))
    for check in lines:
        y += line
        write(f"{check.verdict}: {check.name}: {check.shown}. {check.words}", margin, y, 14, (0.3, 0.3, 0.3))
    y += line + margin
    for row in rows:
        write(row.title, margin, y, 16)
        x = margin
        for colour, words in row.key:
            pen.rectangle((x, y + line + 4, x + 10, y + line + 14), rgb(colour))
            write(words, x + 16, y + line, 13, (0.3, 0.3, 0.3))
            x += 36 + round(pen.textlength(words, ImageFont.load_default(13)))
        y += 2 * line
        for column, picture in enumerate(row.pictures):
            sheet.paste(picture, (margin + column * PICTURE_PIXELS, y), picture)
        y += row.pictures[0].height + margin
    file = BytesIO()
    sheet.save(file, "PNG")
    write_file(target, file.getvalue())
    return target
