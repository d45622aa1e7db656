"""The page of one inspected scan: the checks, the pictures, and an interactive 3D viewer.

As a file, it is self-contained: pictures, points, styles and scripts are inlined, and the page makes no
requests. A server has styles and scripts at addresses of their own, because its pages have none inlined.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pcretrieve.draw import CLAY
from pcretrieve.inspection.inspection import Inspection
from pcretrieve.pages.html import page_template
from pcretrieve.pages.inspection_pictures import (
    AWAY,
    BRIDGE,
    CUT,
    CUT_AWAY,
    DROPPED,
    FACING,
    FILLED,
    KEPT,
    SKIN_WIDTH,
    inspection_cameras,
    rows_of,
    thinned,
)
from pcretrieve.pages.scene import VIEWER_SIZE, Cube, encoded
from pcretrieve.values import FloatArray
from pcretrieve.values.files import write_file

__all__ = ["Served", "inspection_html", "write_inspection_page"]

# Number of points that were removed, side by side, across half of the 3D viewer.
REMOVED_IN_VIEW = 90


class Served(NamedTuple):
    """Where a page of a server leads to."""

    title: str
    back: str


def inspection_html(inspection: Inspection, served: Served | None = None) -> str:
    """The page of an inspection."""
    return page_template("inspection.html").render(
        it=inspection,
        rows=[row.encoded() for row in rows_of(inspection)],
        scene=_scene(inspection),
        plot=_plot(inspection),
        served=served,
    )


def write_inspection_page(inspection: Inspection, path: str | Path) -> Path:
    """Write the page of an inspection. An existing file is replaced in one step, or left unchanged."""
    target = Path(path).absolute()
    write_file(target, inspection_html(inspection).encode("utf-8", errors="replace"))
    return target


# --- the 3D viewer --------------------------------------------------------------------------------------


def _scene(it: Inspection) -> dict[str, Any] | None:
    """The layers of points or faces that the 3D viewer draws, as base64 of little-endian arrays."""
    cameras = inspection_cameras(it)
    if not cameras:
        return None
    cube = Cube.around(it.body)
    layers = []
    if it.scan is not None:
        skin, removed = SKIN_WIDTH / 2 * it.spacing, cube.half / REMOVED_IN_VIEW
        inside = cube.holds(it.scan.points)
        for name, words, chosen, colour, width in (
            ("points", "points", ~(it.dropped | it.cut_away), KEPT, skin),
            ("dropped", "dropped as outliers", it.dropped, DROPPED, max(skin, removed)),
            ("cut", "cut away", it.cut_away, CUT_AWAY, max(skin, removed)),
        ):
            n_far = int((chosen & ~inside).sum())
            label = f"{int(chosen.sum()):,} {words}" + (f", {n_far:,} of them too far away" if n_far else "")
            layers.append(
                cube.layer(name, label, thinned(it.scan.points[chosen & inside]), colour, width=width)
            )
    if it.cloud is not None and it.cloud.normals is not None:
        normals = np.round(127 * thinned(it.cloud.normals)).astype(np.int8)
        points, width = thinned(it.cloud.points), SKIN_WIDTH * it.spacing
        more = {"back": AWAY, "normal": encoded(normals)}
        layers.append(cube.layer("normals", "which side is outside", points, FACING, width=width, **more))
    if it.mesh is not None:
        vertices = it.mesh.vertices
        for name, label, faces, colour in (
            ("surface", "surface", it.mesh.faces, CLAY),
            ("filled", "filled in", it.mesh.faces[it.filled], FILLED),
        ):
            corners = encoded(faces.astype("<u4"))
            layers.append(cube.layer(name, label, vertices, colour, width=0, faces=corners))
        for name, places, colour in (("cuts", it.cuts, CUT), ("bridges", it.bridges, BRIDGE)):
            layers.append(cube.layer(name, name, places, colour, width=cube.half / 30, over=True))
    on = {"surface", "filled", "cuts", "bridges"} if it.mesh is not None else {"points", "dropped"}
    return {"layers": layers, "on": sorted(on), "axes": cameras[0].axes.tolist(), "zoom": VIEWER_SIZE}


# --- the signature ------------------------------------------------------------------------------------


class _Plot(NamedTuple):
    """Logarithms of a signature in the unit square of an SVG, whose y axis points down."""

    line: str
    band: str
    bars: list[tuple[float, float]]
    highest: float
    lowest: float
    largest: float


def _plot(it: Inspection) -> _Plot | None:
    if it.signature is None:
        return None
    logs = np.log(it.signature.values)  # (L,)
    deviation = np.zeros_like(logs) if it.rescan_deviation is None else it.rescan_deviation
    low, high = float((logs - deviation).min()), float((logs + deviation).max())
    across = (np.arange(len(logs)) + 0.5) / len(logs)
    largest = float(deviation.max())

    def along(values: Sequence[float] | FloatArray, order: slice = slice(None)) -> str:
        down = (high - np.asarray(values)) / max(high - low, np.finfo(float).tiny)
        pairs = zip(across[order], down[order], strict=True)
        return " ".join(f"{x:.4f},{y:.4f}" for x, y in pairs)

    band = along(logs + deviation) + " " + along(logs - deviation, slice(None, None, -1))
    heights = deviation / max(largest, np.finfo(float).tiny)
    bars = [(float(x), float(height)) for x, height in zip(across, heights, strict=True)]
    return _Plot(along(logs), band, bars, high, low, largest)
