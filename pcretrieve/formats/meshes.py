"""The mesh formats OBJ, and by trimesh OFF and STL.

trimesh would duplicate the vertices of an OBJ file at the seams of textures, normals and materials, which
opens a closed surface. Its ``v`` and ``f`` lines are therefore read here.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import ScanReadError
from pcretrieve.formats.format import Format, RawScan, fans, incomplete, merged_vertices, text_lines
from pcretrieve.values import TriangleMesh

# Largest vertex number of an OBJ file; more than any file has.
LARGEST_NUMBER = 2**40


def mesh_bytes(mesh: TriangleMesh, file_type: str) -> bytes:
    """The content of a mesh file, in the unit of the mesh."""
    data = mesh.to_trimesh().export(file_type=file_type)
    return data.encode() if isinstance(data, str) else bytes(data)


@contextmanager
def damage(path: Path) -> Iterator[None]:
    """Turn what a library raises for a damaged file, exceptions of any class, into an error of the file."""
    try:
        yield
    except (OSError, MemoryError):
        raise
    except ScanReadError as error:
        raise incomplete(path, error.message) from error
    except Exception as error:
        raise incomplete(path, error) from error


def _read_obj(path: Path) -> RawScan:
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


def _arrays(path: Path, file_type: str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The (n, 3) vertices and the (m, 3) triangles of a file as trimesh reads them, with nothing merged."""
    import trimesh

    # An open file, because trimesh takes names in UTF-8 only.
    with damage(path), path.open("rb") as file:
        mesh: Any = trimesh.load(file, file_type=file_type, process=False, force="mesh")
        vertices = np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3)
        return vertices, np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)


def _read_off(path: Path) -> RawScan:
    vertices, faces = _arrays(path, "off")
    if not len(vertices):
        raise incomplete(path, "it holds no vertices")
    return RawScan(vertices, faces if len(faces) else None)


def _read_stl(path: Path) -> RawScan:
    vertices, faces = _arrays(path, "stl")
    if not len(faces):
        raise incomplete(path, "it holds no triangles")
    return RawScan(*merged_vertices(vertices, faces))


OBJ = Format((".obj",), _read_obj, write_mesh=partial(mesh_bytes, file_type="obj"))
OFF = Format((".off",), _read_off, write_mesh=partial(mesh_bytes, file_type="off"))
STL = Format((".stl",), _read_stl, write_mesh=partial(mesh_bytes, file_type="stl"))
