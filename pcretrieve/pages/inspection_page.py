"""One scan, inspected: its findings, and a page of them with pictures and an interactive 3D viewer.

As a file, the page is self-contained: pictures, points, styles and scripts are inlined, and it makes no
requests. A server has styles and scripts at addresses of their own, because its pages have none inlined.
"""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from pcretrieve import Inspection, PointCloud
from pcretrieve.draw.pictures import CLAY, Colour, rgb
from pcretrieve.options import OptionsLike
from pcretrieve.pages.html import encoded, page_of
from pcretrieve.pages.inspection_pictures import (
    AWAY,
    BRIDGE,
    CUT,
    CUT_AWAY,
    DROPPED,
    FACING,
    FAULT,
    FILLED,
    KEPT,
    PICTURE_PIXELS,
    SKIN_WIDTH,
    inspection_cameras,
    rows_of,
    thinned,
)
from pcretrieve.pages.scene import VIEWER_SIZE, Cube
from pcretrieve.values.conversion import GeometryLike
from pcretrieve.values.files import write_file

# Number of points that were removed, side by side, across half of the 3D viewer.
REMOVED_IN_VIEW = 90

# The sheet of pictures: its margin, the height of a line and of the title, in pixels, and its two greys.
MARGIN = 16
LINE = 22
TITLE = 34
DARK = (0.1, 0.1, 0.1)
GREY = (0.3, 0.3, 0.3)


def inspect(
    scan: str | Path | GeometryLike,
    options: OptionsLike = None,
    *,
    n_rescans: int = 4,
    page: str | Path | None = None,
    png: str | Path | None = None,
) -> Inspection:
    """Process a scan, and check the result of each stage.

    Parameters
    ----------
    scan : ScanLike
        A path, an array or geometry.
    options : OptionsLike, optional
        Options, a preset's name, a TOML file, or a mapping.
    n_rescans : int, default 4
        Number of surfaces that are reconstructed from nine tenths of the points, for the rescan deviation of
        the signature; 0 for none.
    page : str or Path, optional
        An HTML file to which a page with the results is written.
    png : str or Path, optional
        A PNG file to which the pictures of the page are written.

    Returns
    -------
    Inspection
        Points, normals, surface, checks and signature, which is that of `r_bihdm`; those of the earlier
        stages if a stage fails.

    Raises
    ------
    InputError
        If `scan` cannot be converted to a cloud or a mesh, or a file cannot be written.
    ScanReadError
        If the file is no scan.
    """
    from pcretrieve.pipeline.inspecting import check_targets, inspect_scan

    check_targets(scan, page, png)
    found = inspect_scan(scan, options, n_rescans=n_rescans)
    if page is not None:
        write_file(Path(page).absolute(), inspection_html(found))
    if png is not None:
        write_inspection_png(found, png)
    return found


def inspection_html(it: Inspection, served: tuple[str, str] | None = None) -> bytes:
    """The page of an inspection; of a server, with its title and the address that the page leads back to."""
    scene, turns = _scene(it), _turns(it)
    rows = rows_of(it)
    return page_of(
        "inspection.html", it=it, rows=rows, scene=scene, turns=turns, served=served
    )


def _turns(it: Inspection) -> dict[str, str]:
    """For each check that has a place: the address at which the 3D viewer shows it from its front."""
    cameras = inspection_cameras(it)
    if not cameras or it.mesh is None:
        return {}
    found, centre = {}, Cube.around(it.body).centre
    for check in it.checks:
        if not check.places:
            continue
        away = np.array(check.places[0]) - centre
        across, above, ahead = cameras[0].axes @ away
        right = np.degrees(np.arctan2(across, ahead))
        up = np.degrees(np.arctan2(above, np.hypot(across, ahead)))
        found[check.name] = f"#surface,filled,faults@{right:.0f},{up:.0f}"
    return found


def _scene(it: Inspection) -> dict[str, Any] | None:
    """The layers of points or faces that the 3D viewer draws, as base64 of little-endian arrays."""
    cameras = inspection_cameras(it)
    if not cameras:
        return None
    cube = Cube.around(it.body)
    layers = [] if it.scan is None else _point_layers(it, it.scan, cube)
    if it.cloud is not None and it.cloud.normals is not None:
        normals = np.round(127 * thinned(it.cloud.normals)).astype(np.int8)
        points, width = thinned(it.cloud.points), SKIN_WIDTH * it.spacing
        more = {"back": AWAY, "normal": encoded(normals.tobytes())}
        layers.append(
            cube.layer(
                "normals", "which side is outside", points, FACING, width=width, **more
            )
        )
    if it.mesh is not None:
        for name, label, faces, colour in (
            ("surface", "surface", it.mesh.faces, CLAY),
            ("filled", "filled in", it.mesh.faces[it.filled], FILLED),
        ):
            corners = encoded(faces.astype("<u4").tobytes())
            layers.append(
                cube.layer(name, label, it.mesh.vertices, colour, width=0, faces=corners)
            )
        for name, places, colour in (
            ("cuts", it.cuts, CUT),
            ("bridges", it.bridges, BRIDGE),
            ("faults", it.rings, FAULT),
        ):
            layers.append(
                cube.layer(name, name, places, colour, width=cube.half / 30, over=True)
            )
    made = {"surface", "filled", "cuts", "bridges", "faults"}
    on = made if it.mesh is not None else {"points", "dropped"}
    return {
        "layers": layers,
        "on": sorted(on),
        "axes": cameras[0].axes.tolist(),
        "zoom": VIEWER_SIZE,
    }


def _point_layers(it: Inspection, scan: PointCloud, cube: Cube) -> list[dict[str, Any]]:
    """The points that were kept, dropped and cut away, as far as they are in the cube."""
    skin, removed = SKIN_WIDTH / 2 * it.spacing, cube.half / REMOVED_IN_VIEW
    inside = cube.holds(scan.points)
    layers = []
    for name, words, chosen, colour, width in (
        ("points", "points", ~(it.dropped | it.cut_away), KEPT, skin),
        ("dropped", "dropped as outliers", it.dropped, DROPPED, max(skin, removed)),
        ("cut", "cut away", it.cut_away, CUT_AWAY, max(skin, removed)),
    ):
        n_far = int((chosen & ~inside).sum())
        label = f"{int(chosen.sum()):,} {words}" + (
            f", {n_far:,} of them too far away" if n_far else ""
        )
        layers.append(
            cube.layer(
                name, label, thinned(scan.points[chosen & inside]), colour, width=width
            )
        )
    return layers


def write_inspection_png(inspection: Inspection, path: str | Path) -> Path:
    """Write the outcome and all pictures into one picture. An existing file is replaced in one step."""
    target = Path(path).absolute()
    rows = rows_of(inspection)
    width = 2 * MARGIN + len(inspection_cameras(inspection) or [0] * 4) * PICTURE_PIXELS
    lines = [check for check in inspection.checks if check.outcome != "passed"]
    height = 3 * MARGIN + TITLE + LINE * (1 + len(lines))
    height += sum(row.pictures[0].height + 2 * LINE + MARGIN for row in rows)
    sheet = Image.new("RGB", (width, height), "white")
    pen = ImageDraw.Draw(sheet)

    def write(text: str, x: int, y: int, size: int, colour: Colour = DARK) -> None:
        font = ImageFont.load_default(size)
        while text and pen.textlength(text, font) > width - MARGIN - x:
            text = text[:-2].rstrip("…") + "…" if len(text) > 2 else ""
        pen.text((x, y), text, rgb(colour), font)

    write(inspection.name, MARGIN, MARGIN, 24)
    y = MARGIN + TITLE
    write(
        inspection.summary, MARGIN, y, 16, CUT if inspection.outcome == "failed" else DARK
    )
    for check in lines:
        y += LINE
        write(
            f"{check.outcome}: {check.name}: {check.shown}. {check.words}",
            MARGIN,
            y,
            14,
            GREY,
        )
    y += LINE + MARGIN
    for row in rows:
        write(row.title, MARGIN, y, 16)
        x = MARGIN
        for colour, words in row.key:
            pen.rectangle((x, y + LINE + 4, x + 10, y + LINE + 14), rgb(colour))
            write(words, x + 16, y + LINE, 13, GREY)
            x += 36 + round(pen.textlength(words, ImageFont.load_default(13)))
        y += 2 * LINE
        for column, picture in enumerate(row.pictures):
            sheet.paste(picture, (MARGIN + column * PICTURE_PIXELS, y), picture)
        y += row.pictures[0].height + MARGIN
    file = BytesIO()
    sheet.save(file, "PNG")
    write_file(target, file.getvalue())
    return target
