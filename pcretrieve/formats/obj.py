"""The format OBJ, vertices and faces only.

Mesh libraries duplicate vertices at the seams of textures, normals and materials, which opens a closed
surface. This reader keeps the vertices of the file.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from pcretrieve.formats.format import Format
from pcretrieve.formats.raw import RawScan, fans, incomplete
from pcretrieve.formats.text import text_lines
from pcretrieve.formats.trimesh import mesh_bytes

__all__ = ["OBJ", "read_obj"]

# Largest vertex number; more than any file has.
LARGEST_NUMBER = 2**40


def read_obj(path: Path) -> RawScan:
    """Read the ``v`` and ``f`` lines of an OBJ file; other lines are ignored."""
    vertices: list[list[float]] = []
    polygons: dict[int, list[list[int]]] = {}  # by their number of corners
    for number, line in enumerate(text_lines(path), start=1):
        words = line.split("#")[0].split()
        try:
            if words[:1] == ["v"]:
                x, y, z = words[1:4]
                vertices.append([float(x), float(y), float(z)])
            elif words[:1] == ["f"]:
                corners = [_vertex(word, len(vertices)) for word in words[1:]]
                polygons.setdefault(len(corners), []).append(corners)
        except ValueError as error:
            raise incomplete(path, f"line {number} is {line.strip()!r}") from error
    if not vertices:
        raise incomplete(path, "it holds no vertices")
    faces = fans([np.array(alike) for alike in polygons.values()]) if polygons else None
    return RawScan(np.array(vertices), faces)


def _vertex(word: str, n_before: int) -> int:
    """Vertex number, from 0, of ``v``, ``v/t`` or ``v/t/n``: from 1 in the file, negative from the last."""
    number = int(word.split("/")[0])
    if not 0 < abs(number) <= LARGEST_NUMBER:
        raise ValueError(f"vertices are numbered from 1 to {LARGEST_NUMBER}")
    return number - 1 if number > 0 else n_before + number


OBJ = Format((".obj",), read_obj, write_mesh=partial(mesh_bytes, file_type="obj"))
