"""OFF and STL, read by trimesh."""

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

    Returns
    -------
    RawScan
        Vertices and triangles; larger polygons are cut into triangles.

    Raises
    ------
    ScanReadError
        If it is not an OFF file, is cut short, or has no vertices.
    """
    return _read(path)


def read_stl(path: Path) -> RawScan:
    """Read an STL file, binary or text.

    Parameters
    ----------
    path : Path

    Returns
    -------
    RawScan
        Triangles, and their corners as vertices: corners at the same place, which the format repeats for each
        triangle, are one vertex.

    Raises
    ------
    ScanReadError
        If it is not an STL file, is cut short, or has no triangles.
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
    # trimesh has no exception of its own: a broken file surfaces as whatever its parser met.
    except Exception as error:
        raise incomplete(path, error) from error
    if not len(vertices):
        raise incomplete(path, "it holds no vertices")
    return RawScan(vertices, faces if len(faces) else None)
