"""Pictures of one inspected scan, in rows of one layer from all sides, with defects marked by colours."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from pcretrieve import Inspection, PointCloud, TriangleMesh
from pcretrieve.draw.axes import body_axes
from pcretrieve.draw.pictures import (
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
from pcretrieve.values import FloatArray

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
FAULT = (0.10, 0.10, 0.10)

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
        top, bottom = (
            min((box[1] for box in boxes), default=0),
            max((box[3] for box in boxes), default=1),
        )
        cut = [picture.crop((0, top, picture.width, bottom)) for picture in self.pictures]
        object.__setattr__(self, "pictures", cut)

    def files(self) -> list[bytes]:
        """The pictures as PNG with a palette."""
        files = [BytesIO() for _ in self.pictures]
        for picture, file in zip(self.pictures, files, strict=True):
            picture.quantize(N_COLOURS).save(file, "PNG", optimize=True)
        return [file.getvalue() for file in files]


def inspection_cameras(it: Inspection) -> list[Camera]:
    """The cameras of all pictures of an inspection."""
    axes = (
        None
        if it.mesh is None
        else body_axes(it.mesh.vertices, it.mesh.faces, it.mesh.up)
    )
    return cameras_around(it.body, axes) if len(it.body) else []


def rows_of(it: Inspection) -> list[Row]:
    """The rows of pictures of an inspection."""
    if not len(it.body):
        return []
    seen, rows = _Views(it), []
    if it.scan is not None:
        if it.cut_away.any() or seen.beyond(it.scan.points[it.dropped]).any():
            rows.append(seen.overview(it.scan))
        rows.append(seen.points_of_the_body(it.scan))
    if it.cloud is not None and it.cloud.normals is not None:
        rows.append(seen.sides(it.cloud.points, it.cloud.normals))
    if it.mesh is not None:
        rows.append(seen.surface(it.mesh))
        if it.cloud is not None:
            rows.append(seen.marks(it.mesh))
    return rows


def thinned(points: FloatArray) -> FloatArray:
    """`MOST_POINTS` of (n, 3) points at equal intervals in the order of the file; all if there are fewer."""
    return points[
        np.linspace(0, len(points) - 1, min(len(points), MOST_POINTS)).astype(np.intp)
    ]


class _Views:
    """An inspection, seen from four sides."""

    def __init__(self, it: Inspection) -> None:
        self.it, self.cameras, self.skin = (
            it,
            inspection_cameras(it),
            SKIN_WIDTH / 2 * it.spacing,
        )
        self.n_dropped, self.n_cut = int(it.dropped.sum()), int(it.cut_away.sum())

    def overview(self, scan: PointCloud) -> Row:
        """All points; those too far away are at the edge of each picture, in their direction."""
        low, high = self.it.body.min(axis=0), self.it.body.max(axis=0)
        margin = AROUND * np.linalg.norm(high - low)
        near = ((scan.points >= low - margin) & (scan.points <= high + margin)).all(
            axis=1
        )
        corners = [
            body.centre + body.half * np.array(corner) @ body.axes[:2]
            for body in self.cameras
            for corner in ((-1, -1), (-1, 1), (1, -1), (1, 1))
        ]
        shown = np.concatenate([scan.points[near], corners])
        around = cameras_framing(shown, [one.axes for one in self.cameras])
        pictures = [
            self._framed(scan, camera, body)
            for camera, body in zip(around, self.cameras, strict=True)
        ]
        key = [self._key_of_kept(scan)]
        key += [(CUT_AWAY, f"{self.n_cut:,} cut away")] if self.n_cut else []
        key += (
            [(DROPPED, f"{self.n_dropped:,} dropped as outliers")]
            if self.n_dropped
            else []
        )
        key.append((FRAME, "frame of the pictures below"))
        n_far = int((~near).sum())
        far = (
            f", {n_far:,} of them at the edge, because they are too far away"
            if n_far
            else ""
        )
        return Row(f"All points that were read{far}", key, pictures)

    def _framed(self, scan: PointCloud, camera: Camera, body: Camera) -> Image.Image:
        """All points as a camera sees them, with the frame of what the camera of the body sees."""
        picture = Image.new("RGBA", (PICTURE_PIXELS, PICTURE_PIXELS))
        for chosen, colour in (
            (self.it.cut_away, CUT_AWAY),
            (self.it.dropped, DROPPED),
        ):
            seen = camera.seen(thinned(scan.points[chosen]))[:, :2]  # (k, 2)
            seen /= np.maximum(
                abs(seen).max(axis=1, keepdims=True) / (1 - REMOVED_WIDTH), 1
            )
            at_edge = camera.centre + camera.half * seen @ camera.axes[:2]
            picture.alpha_composite(self._removed(at_edge, colour, camera))
        picture.alpha_composite(self._kept(scan, camera))
        across, up = camera.seen(body.centre[None])[0, :2]
        x, y, half = across + 1, 1 - up, body.half / camera.half
        box = [
            PICTURE_PIXELS / 2 * part for part in (x - half, y - half, x + half, y + half)
        ]
        ImageDraw.Draw(picture).rectangle(box, outline=rgb(FRAME))
        return picture

    def points_of_the_body(self, scan: PointCloud) -> Row:
        dropped = scan.points[self.it.dropped]

        def drawn(camera: Camera) -> Image.Image:
            beside = self._removed(thinned(dropped), DROPPED, camera)
            return Image.alpha_composite(self._kept(scan, camera), beside)

        n_beyond = int(self.beyond(dropped).sum())
        beyond = (
            f", {n_beyond:,} of them beyond an edge in some pictures" if n_beyond else ""
        )
        words = f"{self.n_dropped:,} dropped as outliers{beyond}"
        return self._row(
            "Points of the body", [self._key_of_kept(scan), (DROPPED, words)], drawn
        )

    def sides(self, points: FloatArray, normals: FloatArray) -> Row:
        def drawn(camera: Camera) -> Image.Image:
            facing = (normals @ camera.axes[2])[:, None]  # (n, 1)
            colours = np.where(facing > 0, FACING, AWAY) * (
                DARKEST + (1 - DARKEST) * abs(facing)
            )
            return point_picture(
                points, colours, camera, width=2 * self.skin, size=PICTURE_PIXELS
            )

        inside = "inside faces you: a hole, or normals that point inwards"
        return self._row(
            "Which side is outside",
            [(FACING, "outside faces you"), (AWAY, inside)],
            drawn,
        )

    def surface(self, mesh: TriangleMesh) -> Row:
        clay = np.tile(CLAY, (len(mesh.faces), 1))
        return self._row(
            "Surface",
            [(CLAY, f"{len(mesh.faces):,} faces")],
            lambda camera: surface_picture(
                mesh.vertices, mesh.faces, clay, camera, size=PICTURE_PIXELS
            ),
        )

    def marks(self, mesh: TriangleMesh) -> Row:
        it = self.it
        colours, rings = (
            np.where(it.filled[:, None], FILLED, CLAY),
            [(it.cuts, CUT), (it.bridges, BRIDGE), (it.rings, FAULT)],
        )
        shares = [
            f"{check.name.lower()} {check.shown}"
            for check in it.checks
            if check.name in ("Filled in", "Closed base")
        ]
        return self._row(
            "What was filled in, cut and bridged",
            [
                (FILLED, f"no point nearby: {', '.join(shares)}"),
                (CUT, f"cuts: {len(it.cuts)}"),
                (BRIDGE, f"bridges: {len(it.bridges)}"),
                (FAULT, f"places of failed checks: {len(it.rings)}"),
            ],
            lambda camera: surface_picture(
                mesh.vertices,
                mesh.faces,
                colours,
                camera,
                size=PICTURE_PIXELS,
                rings=rings,
            ),
        )

    def beyond(self, points: FloatArray) -> NDArray[np.bool_]:
        """(n,) whether each point is not in the field of view of one of the cameras."""
        outside = [
            (abs(camera.seen(points)[:, :2]) > 1).any(axis=1) for camera in self.cameras
        ]
        return np.asarray(np.any(outside, axis=0))

    def _row(
        self,
        title: str,
        key: list[tuple[Colour, str]],
        drawn: Callable[[Camera], Image.Image],
    ) -> Row:
        return Row(title, key, [drawn(camera) for camera in self.cameras])

    def _key_of_kept(self, scan: PointCloud) -> tuple[Colour, str]:
        return KEPT, f"{len(scan.points) - self.n_dropped - self.n_cut:,} points"

    def _kept(self, scan: PointCloud, camera: Camera) -> Image.Image:
        kept = thinned(scan.points[~(self.it.dropped | self.it.cut_away)])
        return depth_picture(kept, KEPT, camera, width=self.skin, size=PICTURE_PIXELS)

    def _removed(self, points: FloatArray, colour: Colour, camera: Camera) -> Image.Image:
        """Small translucent points."""
        width = max(self.skin, 2 * REMOVED_WIDTH * camera.half)
        colours = np.tile(colour, (len(points), 1))
        picture = point_picture(points, colours, camera, width=width, size=PICTURE_PIXELS)
        picture.putalpha(
            picture.getchannel("A").point(
                lambda opacity: round(REMOVED_OPACITY * opacity)
            )
        )
        return picture
