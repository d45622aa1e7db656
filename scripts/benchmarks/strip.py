"""The picture at the top of the README: a raw scan, its surface, and its nearest neighbours."""

from __future__ import annotations

import argparse
import io
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from pcretrieve.catalogue import Catalogue
from pcretrieve.draw import CLAY, cameras_around, depth_picture, rgb, surface_picture
from pcretrieve.formats import read_scan
from pcretrieve.pipeline.process import reconstruct
from pcretrieve.query import search
from pcretrieve.values import FloatArray, IntArray
from pcretrieve.values.conversion import as_cloud
from pcretrieve.values.files import write_file

__all__ = ["main"]

SIDE, MARGIN, LINE = 200, 14, 22

INK = (30, 34, 40)

# Points of the scan that are drawn, and their colour; sRGB in [0, 1].
MOST_POINTS = 9000
BLUE = (0.30, 0.45, 0.68)


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw the strip for one scan of a catalogue."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("catalogue", type=Path, help="a catalogue that holds the scan and its neighbours")
    parser.add_argument("scan", type=Path, help="the scan that is searched for")
    parser.add_argument("--output", type=Path, default=Path("docs/strip.png"))
    parser.add_argument("-k", type=int, default=4, help="neighbours that are shown")
    given = parser.parse_args(arguments)
    with Catalogue(given.catalogue) as catalogue:
        found = search(catalogue, given.scan, k=given.k + 1)
        points = as_cloud(read_scan(given.scan)).points
        mesh = reconstruct(given.scan, catalogue.options)
        tiles = [("raw scan", _cloud(points)), ("surface", _surface(mesh.vertices, mesh.faces))]
        for rank, shape_id in enumerate(found.ids[1:], start=1):  # the scan itself is the nearest
            other = catalogue.mesh(shape_id)
            tiles.append((f"{rank}. {shape_id}", _surface(other.vertices, other.faces)))
    font = ImageFont.load_default(15)
    sheet = Image.new("RGB", (len(tiles) * (SIDE + MARGIN) + MARGIN, SIDE + LINE + 2 * MARGIN), "white")
    pen = ImageDraw.Draw(sheet)
    for column, (words, picture) in enumerate(tiles):
        x = MARGIN + column * (SIDE + MARGIN)
        sheet.paste(picture, (x, MARGIN), picture)
        pen.text((x + SIDE / 2, MARGIN + SIDE + 4), words, INK, font, anchor="ma")
    x = MARGIN + 2 * (SIDE + MARGIN) - MARGIN // 2
    pen.line((x, MARGIN, x, MARGIN + SIDE), rgb(CLAY), 2)
    data = io.BytesIO()
    sheet.save(data, "PNG", optimize=True)
    write_file(given.output, data.getvalue())
    sys.stdout.write(f"{given.output}\n")


def _cloud(points: FloatArray) -> Image.Image:
    points = points[:: -(-len(points) // MOST_POINTS)]
    camera = cameras_around(points)[0]
    return depth_picture(points, BLUE, camera, width=0.0, size=SIDE)


def _surface(vertices: FloatArray, faces: IntArray) -> Image.Image:
    colours = np.tile(CLAY, (len(faces), 1))
    return surface_picture(vertices, faces, colours, cameras_around(vertices)[0], size=SIDE)
