"""The picture of docs/method.md: a raw scan, its surface, and its nearest neighbours."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from benchmarks.measuring import png
from pcretrieve.catalogue import Catalogue
from pcretrieve.draw.axes import body_axes
from pcretrieve.draw.pictures import (
    CLAY,
    cameras_around,
    depth_picture,
    rgb,
    surface_picture,
)
from pcretrieve.formats import read_scan
from pcretrieve.gallery.answers import search
from pcretrieve.pipeline.process import reconstruct
from pcretrieve.values import FloatArray, IntArray
from pcretrieve.values.conversion import as_cloud
from pcretrieve.values.files import write_file

__all__ = ["main"]

# Side of a picture, space between two, and height of the line below; pixels.
TILE, MARGIN, LINE = 200, 14, 22

INK = (30, 34, 40)

# Points of the scan that are drawn, and their colour; sRGB in [0, 1].
MOST_POINTS = 9000
BLUE = (0.30, 0.45, 0.68)


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw the strip for one scan of a catalogue."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "catalogue", type=Path, help="a catalogue that holds the scan and its neighbours"
    )
    parser.add_argument("scan", type=Path, help="the scan that is searched for")
    parser.add_argument("--output", type=Path, default=Path("docs/strip.png"))
    parser.add_argument("-k", type=int, default=4, help="neighbours that are shown")
    given = parser.parse_args(arguments)
    with Catalogue(given.catalogue) as catalogue:
        found = search(catalogue, given.scan, k=given.k + 1).neighbors
        points = as_cloud(read_scan(given.scan)).points
        mesh = reconstruct(given.scan, catalogue.options)
        axes = body_axes(mesh.vertices, mesh.faces)
        tiles = [
            ("raw scan", _cloud(points, axes)),
            ("surface", _surface(mesh.vertices, mesh.faces)),
        ]
        for rank, shape_id in enumerate(
            found.ids[1:], start=1
        ):  # the scan itself is the nearest
            other = catalogue.mesh(shape_id)
            tiles.append((f"{rank}. {shape_id}", _surface(other.vertices, other.faces)))
    sheet = captioned(tiles, len(tiles))
    x = MARGIN + 2 * (TILE + MARGIN) - MARGIN // 2
    ImageDraw.Draw(sheet).line((x, MARGIN, x, MARGIN + TILE), rgb(CLAY), 2)
    write_file(given.output, png(sheet))
    sys.stdout.write(f"{given.output}\n")


def captioned(tiles: Sequence[tuple[str, Image.Image]], n_columns: int) -> Image.Image:
    """Pictures in rows, each over its words."""
    width, height, n_rows = (
        TILE + MARGIN,
        TILE + MARGIN + LINE,
        -(-len(tiles) // n_columns),
    )
    sheet = Image.new(
        "RGB", (n_columns * width + MARGIN, n_rows * height + MARGIN), "white"
    )
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(15)
    for number, (words, picture) in enumerate(tiles):
        x, y = MARGIN + number % n_columns * width, MARGIN + number // n_columns * height
        sheet.paste(picture, (x, y), picture)
        pen.text((x + TILE / 2, y + TILE + 4), words, INK, font, anchor="ma")
    return sheet


def _cloud(points: FloatArray, axes: FloatArray) -> Image.Image:
    points = points[:: -(-len(points) // MOST_POINTS)]
    camera = cameras_around(points, axes)[0]
    return depth_picture(points, BLUE, camera, width=0.0, size=TILE)


def _surface(vertices: FloatArray, faces: IntArray) -> Image.Image:
    colours = np.tile(CLAY, (len(faces), 1))
    camera = cameras_around(vertices, body_axes(vertices, faces))[0]
    return surface_picture(vertices, faces, colours, camera, size=TILE)
