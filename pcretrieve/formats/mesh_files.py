"""The formats OFF and STL, read by trimesh."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pcretrieve.formats.raw import RawScan, incomplete, merged_vertices

__all__ = ["read_off", "read_stl"]


def read_off(path: Path) -> RawScan:
    """Read an OFF file.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    RawScan
        Vertices and triangles; polygons are triangulated. Unit of the file.

    Raises
    ------
    OSError
        If the file cannot be read.
    MemoryError
        If the file is too large for the memory.
    ScanReadError
        If the file is not an OFF file, is truncated, or has no vertices.
    """
    return _read(path)


def read_stl(path: Path) -> RawScan:
    """Read an STL file, binary or text.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    RawScan
        Triangles and vertices; corners of triangles at the same place are merged into one vertex. Unit of the
        file.

    Raises
    ------
    OSError
        If the file cannot be read.
    MemoryError
        If the file is too large for the memory.
    ScanReadError
        If the file is not an STL file, is truncated, or has no triangles.
    """
    scan = _read(path)
    if scan.faces is None:
        raise incomplete(path, "it holds no triangles")
    vertices, faces = merged_vertices(scan.points, scan.faces)
    return RawScan(vertices, faces)


def _read(path: Path) -> RawScan:
    import trimesh

    try:
        mesh: Any = trimesh.load(path, file_type=path.suffix[1:].lower(), process=False, force="mesh")
        vertices = np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3)
        faces = np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
    except (OSError, MemoryError):
        raise
    # trimesh has no exception class of its own: a damaged file raises whatever its parser does.
    except Exception as error:
        raise incomplete(path, error) from error
    if not len(vertices):
        raise incomplete(path, "it holds no vertices")
    return RawScan(vertices, faces if len(faces) else None)
