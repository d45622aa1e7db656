"""The format PLY: text, and binary of both byte orders."""

from __future__ import annotations

import warnings
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import ScanReadError
from pcretrieve.formats.columns import columns_of
from pcretrieve.formats.format import Format
from pcretrieve.formats.ply_header import Element, read_header
from pcretrieve.formats.ply_rows import Table, in_order, tables
from pcretrieve.formats.raw import RawScan, fans, incomplete
from pcretrieve.formats.trimesh import mesh_bytes
from pcretrieve.values import PointCloud

__all__ = ["PLY", "read_ply"]

FACE_PROPERTIES = ("vertex_indices", "vertex_index")

# Largest value of the types of an index.
LARGEST_INDEX = 2**32 - 1


def read_ply(path: Path) -> RawScan:
    """Read a PLY file."""
    data = path.read_bytes()
    header = read_header(path, data)
    # Elements after the vertices and the faces are not read, such as the sampling grid of range scanners.
    needed = [k for k, found in enumerate(header.elements) if found.name == "vertex" or _is_face(found)]
    scan, faces, at = None, None, header.end
    for element in header.elements[: needed[-1] + 1] if needed else ():
        if header.is_text:
            found, at = _of_text(path, data, at, element)
        else:
            body = np.frombuffer(data, np.uint8, offset=at)
            found, used = tables(path, body, element, header.order)
            at += used
        if element.name == "vertex":
            scan = _vertices(element, found)
        elif _is_face(element):
            faces = _faces(path, element, found)
    if scan is None:
        raise ScanReadError("a PLY scan must have an element 'vertex', this file has none")
    return scan._replace(faces=faces)


def _is_face(element: Element) -> bool:
    return element.name == "face" and element.n_rows > 0


def _vertices(element: Element, found: list[Table]) -> RawScan:
    scalars = {one.name: one.type for one in element.properties if one.length is None}

    def columns(*names: str) -> NDArray[np.float64] | None:
        if not scalars.keys() >= {*names}:
            return None
        if not found:
            return np.empty((0, len(names)))
        # Numbers of a text file are rounded to the precision of their type.
        parts = [
            [table.values[name].astype("f4" if scalars[name] == "f4" else "f8") for name in names]
            for table in found
        ]
        return in_order(
            [(table.numbers, np.hstack(part)) for table, part in zip(found, parts, strict=True)]
        ).astype(np.float64)

    points = columns("x", "y", "z")
    if points is None:
        raise ScanReadError("the vertices of a PLY scan must have the numbers x, y and z")
    return RawScan(points, None, columns("nx", "ny", "nz"), columns("vp_x", "vp_y", "vp_z"))


def _faces(path: Path, element: Element, found: list[Table]) -> NDArray[np.int64]:
    """(m, 3) vertex numbers of triangles."""
    lists = {one.name for one in element.properties if one.length is not None and one.type[0] != "f"}
    name = next((name for name in FACE_PROPERTIES if name in lists), None)
    if name is None:
        raise ScanReadError(
            f"the faces of a PLY scan must have the list {' or '.join(FACE_PROPERTIES)} of whole numbers"
        )
    alike: dict[int, list[tuple[NDArray[np.intp], NDArray[Any]]]] = {}
    for table in found:
        corners = table.values[name]
        if corners.dtype.kind == "f" and not ((np.abs(corners) <= LARGEST_INDEX) & (corners % 1 == 0)).all():
            raise incomplete(path, "its faces name vertices by other than whole numbers")
        alike.setdefault(corners.shape[1], []).append((table.numbers, corners))
    return fans([in_order(parts) for parts in alike.values()])


def _of_text(path: Path, data: bytes, at: int, element: Element) -> tuple[list[Table], int]:
    """The rows of an element of a text file, one on each line, and the position of the next element."""
    # The numbers are parsed in one call, and then read as the rows of a binary file of doubles.
    line_end = b"\n" if data.find(b"\n", at) >= 0 else b"\r"
    ends = at + 1 + np.flatnonzero(np.frombuffer(data, np.uint8, offset=at) == line_end[0])
    if element.n_rows > len(ends) + 1:
        raise incomplete(path, f"it ends after {len(ends)} of {element.n_rows} lines of {element.name}")
    stop = int(np.concatenate([[at], ends, [len(data)]])[element.n_rows])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)  # before numpy 2.3 it was no error
            numbers = np.fromstring(data[at:stop], sep=" ")
    except (ValueError, DeprecationWarning) as error:
        raise incomplete(path, f"its lines of {element.name} hold more than numbers") from error
    found, used = tables(path, numbers.view(np.uint8), element.of_doubles(), "=")
    if used != numbers.nbytes:
        raise incomplete(path, f"its lines of {element.name} hold more than its header declares")
    return found, stop


def _ply_bytes(cloud: PointCloud) -> bytes:
    fields, table = columns_of(cloud, "x y z", "nx ny nz", "vp_x vp_y vp_z")
    properties = "".join(f"property double {field}\n" for field in fields)
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(table)}\n{properties}end_header\n"
    return header.encode() + table.astype("<f8").tobytes()


PLY = Format((".ply",), read_ply, write_cloud=_ply_bytes, write_mesh=partial(mesh_bytes, file_type="ply"))
