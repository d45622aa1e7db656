"""A path, an array or geometry of another package → points or a mesh."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

from pcretrieve.formats.read import read_scan
from pcretrieve.values import METRES, UNIT, PointCloud, Step, TriangleMesh
from pcretrieve.values.conversion import GeometryLike, as_geometry

__all__ = ["ScanLike", "as_scan"]

#: A file, or what can be converted to a point cloud or a surface.
ScanLike: TypeAlias = "str | Path | GeometryLike"


def as_scan(scan: ScanLike, unit: str = "none") -> PointCloud | TriangleMesh:
    """Read a scan from a path, or convert a value to a scan.

    Returns PointCloud or TriangleMesh: in metres if the unit is known, else in the unit of the file or of the
        value.
    """
    value = read_scan(scan) if isinstance(scan, (str, Path)) else as_geometry(scan)
    if unit == "none" or any(UNIT in step.sizes for step in value.provenance):
        return value
    metres = METRES[unit]
    notes = (f"converted the coordinates from {unit} to m",) if metres != 1 else ()
    step = Step("read", 0.0, {UNIT: 1.0}, notes)
    if isinstance(value, TriangleMesh):
        return replace(value, vertices=value.vertices * metres).after(step)
    viewpoints = None if value.viewpoints is None else value.viewpoints * metres
    return replace(value, points=value.points * metres, viewpoints=viewpoints).after(step)
