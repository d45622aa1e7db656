"""OBJ, vertices and faces only.

A mesh library splits vertices along the seams of textures, normals and materials, which opens a closed
surface; here a face has the vertices that the file gives it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pcretrieve.scan.raw import RawScan, incomplete, triangles
from pcretrieve.scan.text import text_lines

__all__ = ["read_obj"]


def read_obj(path: Path) -> RawScan:
    """The ``v`` and ``f`` lines; larger polygons are cut into triangles, everything else is ignored."""
    vertices: list[list[float]] = []
    polygons: list[list[int]] = []
    for number, line in enumerate(text_lines(path), start=1):
        words = line.split("#")[0].split()
        try:
            if words[:1] == ["v"]:
                x, y, z = words[1:4]
                vertices.append([float(x), float(y), float(z)])
            elif words[:1] == ["f"]:
                polygons.append([_vertex(word, len(vertices)) for word in words[1:]])
        except ValueError as error:
            raise incomplete(path, f"line {number} is {line.strip()!r}") from error
    if not vertices:
        raise incomplete(path, "it holds no vertices")
    return RawScan(np.array(vertices), triangles(polygons) if polygons else None)


def _vertex(word: str, n_before: int) -> int:
    """Position of the vertex that ``v``, ``v/t`` or ``v/t/n`` names: from 1, or backwards from the last."""
    number = int(word.split("/")[0])
    if number == 0:
        raise ValueError("vertices are numbered from 1")
    return number - 1 if number > 0 else n_before + number
