"""Figure 1: a picture of one mesh of each class of a set."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

from pcretrieve.atomic import write_file
from pcretrieve.benchmarks.sets import read_mesh
from pcretrieve.draw import thumbnail
from pcretrieve.ingestion.discover import discover
from pcretrieve.ingestion.labels import read_labels

__all__ = ["figure_1"]

# Pictures in a row; side of a picture, space between two, and height of the line of the class; pixels.
N_COLUMNS, SIDE, MARGIN, LINE = 6, 150, 10, 20

INK = (30, 34, 40)

# Meshes of SHREC'11, one of each class, that the camera of thumbnails shows upright: chosen by eye, because
# that camera knows principal axes and not what is up.
UPRIGHT = {
    *("T18", "T141", "T138", "T41", "T100", "T242", "T488", "T326", "T84", "T368"),
    *("T305", "T467", "T389", "T299", "T42", "T312", "T402", "T396", "T17", "T426"),
    *("T224", "T28", "T32", "T463", "T271", "T111", "T0", "T535", "T180", "T238"),
}


def figure_1(folder: Path, sheet: Path | None) -> Iterator[str]:
    """Draw one mesh of each class: that of `UPRIGHT`, or the first one.

    Parameters
    ----------
    folder : Path
        A set of meshes with their classes in ``labels.csv``.
    sheet : Path or None
        The PNG file to write; None for no picture.

    Yields
    ------
    str
        A line: the set, its classes, and the file that was written.
    """
    classes = read_labels(folder / "labels.csv")
    paths = [path for path in discover([folder]) if path.name in classes]
    shown: dict[str, Path] = {}
    for path in sorted(paths, key=lambda path: path.stem not in UPRIGHT):
        shown.setdefault(classes[path.name], path)
    yield f"Figure 1: {len(paths)} meshes of {folder.name}, of {len(shown)} classes"
    if sheet is not None:
        write_file(sheet, _sheet(dict(sorted(shown.items()))))
        yield f"wrote {sheet}: one mesh of each class"


def _sheet(shown: dict[str, Path]) -> bytes:
    """A PNG file of meshes, each over the name of its class."""
    rows = -(-len(shown) // N_COLUMNS)
    step = SIDE + MARGIN
    size = (N_COLUMNS * step + MARGIN, rows * (step + LINE) + MARGIN)
    picture = Image.new("RGB", size, "white")
    pen, font = ImageDraw.Draw(picture), ImageFont.load_default(13)
    for number, (label, path) in enumerate(shown.items()):
        row, column = divmod(number, N_COLUMNS)
        x, y = MARGIN + column * step, MARGIN + row * (step + LINE)
        mesh = read_mesh(path)
        with Image.open(io.BytesIO(thumbnail(mesh.vertices, mesh.faces, size=SIDE))) as body:
            tile = body.convert("RGBA")
        picture.paste(tile, (x, y), tile)
        pen.text((x + SIDE / 2, y + SIDE), label, INK, font, anchor="ma")
    data = io.BytesIO()
    picture.save(data, "PNG", optimize=True)
    return data.getvalue()
