"""The format STL, binary and text, read and written by trimesh."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from pcretrieve.formats.format import Format
from pcretrieve.formats.raw import RawScan, incomplete, merged_vertices
from pcretrieve.formats.trimesh import mesh_arrays, mesh_bytes

__all__ = ["STL", "read_stl"]


def read_stl(path: Path) -> RawScan:
    """Read an STL file, binary or text."""
    try:
        vertices, faces = mesh_arrays(path, "stl")
    except ValueError as error:
        raise incomplete(path, error) from error
    if not len(faces):
        raise incomplete(path, "it holds no triangles")
    return RawScan(*merged_vertices(vertices, faces))


STL = Format((".stl",), read_stl, write_mesh=partial(mesh_bytes, file_type="stl"))
