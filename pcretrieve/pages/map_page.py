"""Catalogue → a map of its shapes in the plane: a picture, or a page that shows names and thumbnails."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.catalogue import Catalogue
from pcretrieve.errors import InputError
from pcretrieve.options import PipelineOptions
from pcretrieve.pages.html import page_template
from pcretrieve.pages.thumbnails import Thumbnails
from pcretrieve.retrieval import plane_map
from pcretrieve.values import FloatArray
from pcretrieve.values.files import write_file

__all__ = ["ClassGroup", "class_groups", "map_drawing", "write_map"]

# Colours that colour-blind readers can distinguish, after Okabe and Ito, and darker ones for lines of print.
# Classes have a colour and a marker; of more classes than pairs of both, some look alike.
COLOURS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#8a8d00", "#7b3fa0")
MARKERS = ("o", "s", "^", "D", "v")
UNKNOWN = "#8a8f98"

# The markers as SVG paths of about equal area, in pixels of the map.
PATHS = {
    "o": "M-9,0a9,9 0 1,0 18,0a9,9 0 1,0 -18,0z",
    "s": "M-8,-8h16v16h-16z",
    "^": "M0,-11L10,7H-10z",
    "D": "M0,-11L10,0L0,11L-10,0z",
    "v": "M0,11L10,-7H-10z",
}

# Side of the map, and its margin; pixels.
SIDE = 1000
MARGIN = 30

# Largest number of shapes with thumbnails, so that the page stays below 2 MB; more have names alone.
MOST_PICTURES = 300
PICTURE_PIXELS = 128


class ClassGroup(NamedTuple):
    """The shapes of one class, and how they are drawn.

    rows: (m,) int, numbers of its shapes.
    """

    label: str | None
    rows: NDArray[np.intp]
    colour: str
    marker: str


def write_map(
    catalogue: Catalogue,
    path: str | Path,
    options: PipelineOptions | None = None,
    *,
    up: str | None = None,
) -> Path:
    """Draw the shapes of a catalogue in the plane. An existing file is replaced in one step."""
    target = Path(path).absolute()
    if target.suffix.lower() not in (".png", ".html"):
        raise InputError(f"a map is a picture .png or a page .html, got {target.name}")
    index = catalogue.index(options)
    labels = [record.label for record in catalogue.records(status="done") if record.id in index.ids]
    groups = class_groups(labels)
    title = f"Map of {Path(catalogue.location).name}"
    places = plane_map(index)
    if target.suffix.lower() == ".png":
        from pcretrieve.draw.plot import draw_places

        drawn = [(group.label, places[group.rows], group.colour, group.marker) for group in groups]
        write_file(target, draw_places(drawn, title=title))
        return target
    page = page_template("map.html").render(
        title=title,
        drawing=map_drawing(list(index.ids), groups, places),
        pictures=_pictures(catalogue, list(index.ids), up),
        n_shapes=len(index),
        whitening=index.whitening.reason,
    )
    write_file(target, page.encode("utf-8", errors="replace"))
    return target


def map_drawing(ids: Sequence[str], groups: Sequence[ClassGroup], places: FloatArray) -> dict[str, object]:
    """What the templates draw of a map.

    places: (n, 2) float64, the place of each, within [0, 1]².
    """
    return {
        "side": SIDE,
        "top": SIDE - float(places[:, 1].max()) * (SIDE - 2 * MARGIN) - 2 * MARGIN,
        "height": float(np.ptp(places[:, 1])) * (SIDE - 2 * MARGIN) + 2 * MARGIN,
        "groups": [
            {
                "label": group.label,
                "colour": group.colour,
                "path": PATHS[group.marker],
                "shapes": [_shape(row, ids[row], places[row]) for row in group.rows.tolist()],
            }
            for group in groups
        ],
    }


def class_groups(labels: Sequence[str | None]) -> list[ClassGroup]:
    """The classes in alphabetical order, then the shapes of unknown class."""
    names = sorted({label for label in labels if label is not None})
    groups = []
    for number, name in enumerate(names):
        rows = np.flatnonzero([label == name for label in labels])
        marker = MARKERS[number // len(COLOURS) % len(MARKERS)]
        groups.append(ClassGroup(name, rows, COLOURS[number % len(COLOURS)], marker))
    unknown = np.flatnonzero([label is None for label in labels])
    return groups + ([ClassGroup(None, unknown, UNKNOWN, "o")] if len(unknown) else [])


def _shape(row: int, shape_id: str, place: FloatArray) -> dict[str, object]:
    x, y = MARGIN + place * (SIDE - 2 * MARGIN)
    # The y axis of SVG points down.
    return {"number": row, "id": shape_id, "x": f"{x:.1f}", "y": f"{SIDE - y:.1f}"}


def _pictures(catalogue: Catalogue, ids: list[str], up: str | None) -> list[str | None]:
    """The thumbnails as base64; None for a shape whose mesh is not stored or cannot be drawn."""
    thumbnails = Thumbnails(up, PICTURE_PIXELS)
    if len(ids) > MOST_PICTURES:
        return []
    drawn = (thumbnails.of(catalogue, record) for record in catalogue.several(ids))
    return [None if picture is None else b64encode(picture).decode("ascii") for picture in drawn]
