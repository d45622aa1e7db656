"""Whatever stands for a scan → points or a mesh."""

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
    """The point cloud or the mesh that a path or a value of another package stands for.

    Parameters
    ----------
    scan : ScanLike
        A path as in `read_scan`, or a value as in `as_geometry`.

    Returns
    -------
    PointCloud or TriangleMesh
        In the unit of the file or of the value.

    Raises
    ------
    InputError
        If it is nothing that a scan can be made of.
    ScanReadError
        If the file cannot be read.
    """
    return read_scan(scan) if isinstance(scan, (str, Path)) else as_geometry(scan)
