"""The format OFF, read and written by trimesh."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from pcretrieve.formats.format import Format
from pcretrieve.formats.raw import RawScan, incomplete
from pcretrieve.formats.trimesh import mesh_arrays, mesh_bytes

__all__ = ["OFF", "read_off"]


def read_off(path: Path) -> RawScan:
    """Read an OFF file."""
    try:
        vertices, faces = mesh_arrays(path, "off")
    except ValueError as error:
        raise incomplete(path, error) from error
    if not len(vertices):
        raise incomplete(path, "it holds no vertices")
    return RawScan(vertices, faces if len(faces) else None)


OFF = Format((".off",), read_off, write_mesh=partial(mesh_bytes, file_type="off"))
