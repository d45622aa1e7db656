"""Catalogue → a map of its shapes in the plane: a picture, or a page of thumbnails."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcretrieve import Catalogue, InputError, PipelineOptions, index, places
from pcretrieve.options import OptionsLike
from pcretrieve.pages.html import encoded, write_page
from pcretrieve.pages.thumbnails import Thumbnails
from pcretrieve.values import FloatArray
from pcretrieve.values.files import write_file

# Colours that colour-blind readers can distinguish, after Okabe and Ito, and darker ones for lines of print.
COLOURS = (
    "#0072b2",
    "#e69f00",
    "#009e73",
    "#cc79a7",
    "#56b4e9",
    "#d55e00",
    "#8a8d00",
    "#7b3fa0",
)
UNKNOWN = "#8a8f98"

# Side of the map, and its margin; pixels.
SIDE = 1000
MARGIN = 36

# Largest number of shapes with thumbnails, so that the page stays below 2 MB; more have names alone.
MOST_PICTURES = 300
PICTURE_PIXELS = 128


def draw_map(
    catalogue: Catalogue | str | Path,
    path: str | Path,
    *,
    options: OptionsLike = None,
    up: str | None = None,
) -> Path:
    """Draw the shapes of a catalogue in the plane, near shapes near each other.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The shapes.
    path : str or Path
        The file: a picture if it ends in ``.png``, by matplotlib (the extra ``plot``); a self-contained page
        if it ends in ``.html``, with the thumbnails, and those that are chosen below.
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
        chosen = PipelineOptions.of(options, store.options).without_labels
        made = index(store, options=chosen)
        title = f"Map of {Path(store.location).stem}"
        drawn = places(store, options=chosen)
        if target.suffix.lower() == ".png":
            from pcretrieve.draw.plot import draw_places

            groups = [
                (label, drawn[rows], colour)
                for label, rows, colour in class_groups(made.ids, store)
            ]
            write_file(target, draw_places(groups, title=title))
            return target
        return write_page(
            target,
            "map.html",
            title=title,
            drawing=map_drawing(made.ids, store, drawn),
            pictures=map_pictures(store, made.ids, Thumbnails(store, up, PICTURE_PIXELS)),
            n_shapes=len(made),
            whitening=made.whitening.reason,
        )


def map_drawing(
    ids: Sequence[str], catalogue: Catalogue, places: FloatArray
) -> dict[str, object]:
    """What the templates draw of a map; `places`: (n, 2), within [0, 1]²."""
    across, up = (MARGIN + places * (SIDE - 2 * MARGIN)).T
    down = SIDE - up  # the y axis of SVG points down
    groups = []
    for label, rows, colour in class_groups(ids, catalogue):
        shapes = [(row, ids[row], across[row], down[row]) for row in rows.tolist()]
        groups.append({"label": label, "colour": colour, "shapes": shapes})
    height = float(np.ptp(down)) + 2 * MARGIN
    return {
        "side": SIDE,
        "top": float(down.min()) - MARGIN,
        "height": height,
        "groups": groups,
    }


def class_groups(
    ids: Sequence[str], catalogue: Catalogue
) -> list[tuple[str | None, NDArray[np.intp], str]]:
    """The classes in alphabetical order, then the shapes of unknown class: names, rows and colours."""
    classes = [*map(catalogue.labels().get, ids)]
    names = [*sorted({label for label in classes if label is not None}), None]
    found = [
        (name, np.flatnonzero([label == name for label in classes])) for name in names
    ]
    return [
        (name, rows, UNKNOWN if name is None else COLOURS[number % len(COLOURS)])
        for number, (name, rows) in enumerate(found)
        if len(rows)
    ]


def map_pictures(
    catalogue: Catalogue, ids: Sequence[str], thumbnails: Thumbnails
) -> list[str | None]:
    """The thumbnails as base64; None for a shape whose mesh is not stored or cannot be drawn."""
    if len(ids) > MOST_PICTURES:
        return []
    drawn = (thumbnails.of(catalogue, record) for record in catalogue.rows.several(ids))
    return [None if picture is None else encoded(picture) for picture in drawn]
