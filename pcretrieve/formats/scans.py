"""A path, an array or geometry of another package → points or a mesh."""

from __future__ import annotations

from pathlib import Path
from typing import TypeAlias

from pcretrieve.conversion import GeometryLike, as_geometry
from pcretrieve.formats.read import read_scan
from pcretrieve.types import PointCloud, TriangleMesh

__all__ = ["ScanLike", "as_scan"]

#: A file, or what can be converted to a point cloud or a surface.
ScanLike: TypeAlias = "str | Path | GeometryLike"


def as_scan(scan: ScanLike) -> PointCloud | TriangleMesh:
    """Read a scan from a path, or convert a value to a scan.

    Parameters
    ----------
    scan : ScanLike
        A path as in `read_scan`, or a value as in `as_geometry`.

    Returns
    -------
    PointCloud or TriangleMesh
        The scan; unit of the file or of the value.

    Raises
    ------
    InputError
        If the value cannot be converted to a point cloud or a mesh.
    ScanReadError
        If the file cannot be read.
    """
    return read_scan(scan) if isinstance(scan, (str, Path)) else as_geometry(scan)
