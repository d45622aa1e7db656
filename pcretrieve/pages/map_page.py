"""Catalogue → a map of its shapes in the plane: a picture, or a page that shows names and thumbnails."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve import Catalogue, PipelineOptions
from pcretrieve.errors import InputError
from pcretrieve.options import OptionsLike
from pcretrieve.pages.html import encoded, write_page
from pcretrieve.pages.thumbnails import Thumbnails
from pcretrieve.values import FloatArray
from pcretrieve.values.files import write_file

# Colours that colour-blind readers can distinguish, after Okabe and Ito, and darker ones for lines of print.
# Classes have a colour and a marker; of more classes than pairs of both, some look alike.
COLOURS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#8a8d00", "#7b3fa0")
UNKNOWN = "#8a8f98"

# The markers of matplotlib as SVG paths of about equal area, in pixels of the map.
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
    """The shapes of one class, and how they are drawn; `rows`: (m,) int, numbers of its shapes."""

    label: str | None
    rows: NDArray[np.intp]
    colour: str
    marker: str


def draw_map(
    catalogue: Catalogue | str | Path, path: str | Path, *, options: OptionsLike = None, up: str | None = None
) -> Path:
    """Draw the shapes of a catalogue in the plane, near shapes near each other.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The shapes.
    path : str or Path
        The file: a picture if it ends in ``.png``, by matplotlib (the extra ``plot``); a self-contained page
        if it ends in ``.html``, which shows name and thumbnail of a shape under the pointer.
    options : OptionsLike, optional
        Signature and whitening. By default the options of the catalogue; the whitening auto does not use
        labels.
    up : {"x", "-x", "y", "-y", "z", "-z"}, optional
        The axis of the files that points upwards on pictures; by default found for each shape.

    Returns
    -------
    Path
        Absolute path of the file.

    Raises
    ------
    CatalogueError
        If the options require other spectra than the catalogue has.
    InputError
        If the catalogue has no shapes, the file ends otherwise or cannot be written, or there is no
        matplotlib.
    """
    target = Path(path).absolute()
    if target.suffix.lower() not in (".png", ".html"):
        raise InputError(f"a map is a picture .png or a page .html, got {target.name}")
    with Catalogue.opened(catalogue) as store:
        index = store.index(PipelineOptions.of(options, store.options).without_labels)
        labels = {origin.id: origin.label for origin in store.origins()}
        classes = [labels[shape_id] for shape_id in index.ids]
        title = f"Map of {Path(store.location).name}"
        places = index.places()
        if target.suffix.lower() == ".png":
            from pcretrieve.draw.plot import draw_places

            groups = class_groups(classes)
            drawn = [(group.label, places[group.rows], group.colour, group.marker) for group in groups]
            write_file(target, draw_places(drawn, title=title))
            return target
        return write_page(
            target,
            "map.html",
            title=title,
            drawing=map_drawing(index.ids, classes, places),
            pictures=_pictures(store, list(index.ids), up),
            n_shapes=len(index),
            whitening=index.whitening.reason,
        )


def map_drawing(ids: Sequence[str], labels: Sequence[str | None], places: FloatArray) -> dict[str, object]:
    """What the templates draw of a map; `places`: (n, 2), within [0, 1]²."""
    across, up = (MARGIN + places * (SIDE - 2 * MARGIN)).T
    down = SIDE - up  # the y axis of SVG points down
    groups = []
    for group in class_groups(labels):
        shapes = [
            {"number": row, "id": ids[row], "x": f"{across[row]:.1f}", "y": f"{down[row]:.1f}"}
            for row in group.rows.tolist()
        ]
        path = PATHS[group.marker]
        groups.append({"label": group.label, "colour": group.colour, "path": path, "shapes": shapes})
    height = float(np.ptp(down)) + 2 * MARGIN
    return {"side": SIDE, "top": float(down.min()) - MARGIN, "height": height, "groups": groups}


def class_groups(labels: Sequence[str | None]) -> list[ClassGroup]:
    """The classes in alphabetical order, then the shapes of unknown class."""
    markers = list(PATHS)
    groups = []
    for number, name in enumerate(sorted({label for label in labels if label is not None})):
        rows = np.flatnonzero([label == name for label in labels])
        marker = markers[number // len(COLOURS) % len(markers)]
        groups.append(ClassGroup(name, rows, COLOURS[number % len(COLOURS)], marker))
    unknown = np.flatnonzero([label is None for label in labels])
    return groups + ([ClassGroup(None, unknown, UNKNOWN, "o")] if len(unknown) else [])


def _pictures(catalogue: Catalogue, ids: list[str], up: str | None) -> list[str | None]:
    """The thumbnails as base64; None for a shape whose mesh is not stored or cannot be drawn."""
    if len(ids) > MOST_PICTURES:
        return []
    thumbnails = Thumbnails(up, PICTURE_PIXELS)
    drawn = (thumbnails.of(catalogue, record) for record in catalogue.several(ids))
    return [None if picture is None else encoded(picture) for picture in drawn]
