"""PLY, read by plyfile."""

from __future__ import annotations

import contextlib
import io
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import ScanReadError
from pcretrieve.scan.raw import RawScan, incomplete, triangles

__all__ = ["read_ply"]

END_OF_HEADER = re.compile(rb"end_header[ \t]*\r?\n")
ELEMENT = re.compile(rb"^element[ \t]+(\S+)[ \t]+(\d+)", re.MULTILINE)

FACE_PROPERTIES = ("vertex_indices", "vertex_index")
# What lets plyfile map the faces of a binary file instead of reading them one by one.
ALL_TRIANGLES = {"face": dict.fromkeys(FACE_PROPERTIES, 3)}


def read_ply(path: Path) -> RawScan:
    """Vertices with their normals and sensor positions (``vp_x vp_y vp_z``), and faces if there are any."""
    data = path.read_bytes()
    _check_promises(path, data)
    content = _parsed(path, data)
    if "vertex" not in content:
        raise ScanReadError("a PLY scan must have an element 'vertex', this file has none")
    vertex = content["vertex"].data
    scalars = {name for name in vertex.dtype.names or () if vertex.dtype[name].kind in "fiu"}

    def columns(*names: str) -> NDArray[np.float64] | None:
        if not scalars.issuperset(names):
            return None
        return np.column_stack([vertex[name] for name in names]).astype(np.float64)

    points = columns("x", "y", "z")
    if points is None:
        raise ScanReadError("the vertices of a PLY scan must have the numbers x, y and z")
    faces = None
    if "face" in content and content["face"].count:
        face = content["face"].data
        corners = next((face[name] for name in FACE_PROPERTIES if name in (face.dtype.names or ())), None)
        if corners is None or (corners.ndim == 1 and corners.dtype != object):
            raise ScanReadError(f"the faces of a PLY scan must have the list {' or '.join(FACE_PROPERTIES)}")
        faces = triangles(corners) if corners.ndim == 1 else corners  # (m, 3)
    return RawScan(points, faces, columns("nx", "ny", "nz"), columns("vp_x", "vp_y", "vp_z"))


def _parsed(path: Path, data: bytes) -> Any:
    from plyfile import PlyData, PlyParseError

    needed = _without_trailing_elements(data)
    with warnings.catch_warnings():
        # numpy warns before plyfile raises that the file ended early.
        warnings.simplefilter("ignore", UserWarning)
        if needed is data:
            # Ten times as fast, but fails where a face has more corners or the file is broken.
            with contextlib.suppress(PlyParseError, ValueError, OverflowError, TypeError):
                return PlyData.read(str(path), known_list_len=ALL_TRIANGLES)
        try:
            return PlyData.read(io.BytesIO(needed))
        except (PlyParseError, ValueError, OverflowError, TypeError) as error:
            raise incomplete(path, error) from error


def _check_promises(path: Path, data: bytes) -> None:
    """Before anything is allocated: a vertex or a face takes a byte at least."""
    end = END_OF_HEADER.search(data)
    for found in ELEMENT.finditer(data, 0, end.start() if end else 0):
        # As a float: int refuses a number of thousands of digits.
        promised, left = float(found[2]), len(data) - (end.end() if end else 0)
        if promised > left:
            name = found[1].decode("latin-1")
            raise incomplete(path, f"its header promises {promised:.0f} of {name}, {left} bytes follow")


def _without_trailing_elements(data: bytes) -> bytes:
    """The file with nothing declared behind its last vertex or face.

    Range scanners store their sampling grid behind the points, as text ten times slower to parse than the
    points themselves. A reader stops at the last element that the header names.
    """
    end = END_OF_HEADER.search(data)
    if end is None:
        return data
    header = data[: end.start()]
    elements = [
        (found.start(), found[1])
        for found in ELEMENT.finditer(header)
        if found[1] == b"vertex" or int(found[2])
    ]
    needed = [k for k, (_, name) in enumerate(elements) if name in (b"vertex", b"face")]
    if not needed or needed[-1] == len(elements) - 1:
        return data
    return header[: elements[needed[-1] + 1][0]] + data[end.start() :]
