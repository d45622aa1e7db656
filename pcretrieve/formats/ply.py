"""The format PLY [1]_: text, and binary of both byte orders.

A header declares elements (``vertex``, ``face``, others), the number of rows of each, and the properties of a
row: numbers, and lists of numbers that begin with their length. Rows are stored without an index, and the
length of a list may differ between rows. In most files it does not: all rows are then one view of the file.
Otherwise the positions of the rows are found one after another. The numbers of a text file are parsed in one
call, and then read as the rows of a binary file of doubles.

References
----------
.. [1] Greg Turk, "The PLY Polygon File Format", 1994.
"""

from __future__ import annotations

import re
import struct
import warnings
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from pcretrieve.errors import ScanReadError
from pcretrieve.formats.format import Format, RawScan, columns_of, fans, incomplete
from pcretrieve.formats.meshes import mesh_bytes
from pcretrieve.values import PointCloud

TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float": "f4",
    "double": "f8",
    "float32": "f4",
    "float64": "f8",
}
BYTE_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
# Format characters of the module struct for the types of the length of a list; f8 is for text files.
CODES = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "f8": "d"}

FIRST_LINE = re.compile(rb"\Aply[ \t]*(\r?\n|\r)")
LAST_LINE = {b"\n": rb"\nend_header[ \t]*\r?\n", b"\r": rb"\rend_header[ \t]*\r"}

FACE_PROPERTIES = ("vertex_indices", "vertex_index")
# Largest value of the types of an index.
LARGEST_INDEX = 2**32 - 1


class Property(NamedTuple):
    """A column of an element: one number, or a list of numbers if it has a type of their length."""

    name: str
    type: str
    length: str | None


class Element(NamedTuple):
    """A table of a file: its name, its number of rows, and its columns."""

    name: str
    n_rows: int
    properties: tuple[Property, ...]

    @property
    def is_face(self) -> bool:
        """Whether the rows are polygons."""
        return self.name == "face" and self.n_rows > 0


class Header(NamedTuple):
    """The byte order of a file, empty for text, its elements, and the position of the first row; bytes."""

    order: str
    elements: tuple[Element, ...]
    end: int


class Table(NamedTuple):
    """Rows of an element with equal lengths of lists: their (p,) numbers, and a (p,) array of records."""

    numbers: NDArray[np.intp]
    rows: NDArray[Any]


def read_ply(path: Path) -> RawScan:
    """Read a PLY file."""
    data = path.read_bytes()
    header = _header(path, data)
    # Elements after the vertices and the faces are not read, such as the sampling grid of range scanners.
    needed = [k for k, found in enumerate(header.elements) if found.name == "vertex" or found.is_face]
    scan, faces, at = None, None, header.end
    for element in header.elements[: needed[-1] + 1] if needed else ():
        if header.order:
            found, used = _tables(path, np.frombuffer(data, np.uint8, offset=at), element, header.order)
            at += used
        else:
            found, at = _of_text(path, data, at, element)
        if element.name == "vertex":
            scan = _vertices(element, found)
        elif element.is_face:
            faces = _faces(path, element, found)
    if scan is None:
        raise ScanReadError("a PLY scan must have an element 'vertex', this file has none")
    return scan._replace(faces=faces)


# --- the header -------------------------------------------------------------------------------------------


def _header(path: Path, data: bytes) -> Header:
    first = FIRST_LINE.match(data)
    if first is None:
        raise incomplete(path, "its first line is not 'ply'")
    last = re.compile(LAST_LINE[first[1][-1:]]).search(data, first.start(1))
    if last is None:
        raise incomplete(path, "its header has no line 'end_header'")
    order = None
    elements: list[Element] = []
    for line in data[first.end() : last.start()].splitlines():
        words = line.decode("latin-1").split()
        try:
            match words:
                case [] | ["comment" | "obj_info", *_]:
                    pass
                case ["format", name, "1.0"]:
                    order = BYTE_ORDERS[name]
                case ["element", name, number]:
                    elements.append(Element(name, _n_rows(path, name, number, len(data) - last.end()), ()))
                case ["property", "list", length, type_, name] if TYPES[length][0] != "f":
                    _append(elements, Property(name, TYPES[type_], TYPES[length]))
                case ["property", type_, name]:
                    _append(elements, Property(name, TYPES[type_], None))
                case _:
                    raise LookupError
        except LookupError as error:
            raise incomplete(path, f"its header has the line '{' '.join(words)}'") from error
    if order is None:
        raise incomplete(path, "its header has no line 'format'")
    names = [element.name for element in elements]
    for element in elements:
        own = [found.name for found in element.properties]
        if len({*own}) < len(own) or names.count(element.name) > 1:
            raise incomplete(path, f"its header declares {element.name}, or a property of it, twice")
    return Header(order, tuple(elements), last.end())


def _n_rows(path: Path, name: str, number: str, n_bytes: int) -> int:
    """The number of rows, after a check: a row has at least one byte."""
    if not number.isdecimal():
        raise LookupError
    # float, because int raises an exception for a number of thousands of digits.
    if float(number) > n_bytes:
        raise incomplete(path, f"its header declares {float(number):.0f} of {name}, {n_bytes} bytes follow")
    return int(number)


def _append(elements: list[Element], added: Property) -> None:
    elements[-1] = elements[-1]._replace(properties=(*elements[-1].properties, added))


# --- the rows ---------------------------------------------------------------------------------------------


def _tables(path: Path, body: NDArray[np.uint8], element: Element, order: str) -> tuple[list[Table], int]:
    """The rows of an element in the (b,) bytes from its first row on, and where the next element begins."""
    n = element.n_rows
    if not n:
        return [], 0
    _, width, lengths = next(_places(path, body, element, order))
    if n * width <= len(body):
        rows = body[: n * width].view(_record(element, order, lengths))
        stored = (rows[_length(one.name)] for one in element.properties if one.length is not None)
        if all((column == column[0]).all() for column in stored):
            return [Table(np.arange(n), rows)], n * width
    alike: dict[tuple[int, ...], list[tuple[int, int, int]]] = {}
    stop = 0
    for number, (start, stop, lengths) in enumerate(_places(path, body, element, order)):
        alike.setdefault(lengths, []).append((number, start, stop - start))
    found = []
    for lengths, places in alike.items():
        numbers, starts, (width, *_) = np.array(places, dtype=np.intp).T
        block = sliding_window_view(body, width)[starts]  # (p, w)
        found.append(Table(numbers, block.view(_record(element, order, lengths))[:, 0]))
    return found, stop


def _record(element: Element, order: str, lengths: tuple[int, ...]) -> np.dtype[np.void]:
    """The type of a row whose lists have these lengths."""
    fields: list[Any] = []
    left = iter(lengths)
    for name, type_, length in element.properties:
        if length is None:
            fields.append((name, order + type_))
        else:
            fields += [(_length(name), order + length), (name, order + type_, (next(left),))]
    return np.dtype(fields)


def _length(name: str) -> str:
    """The field of the length of a list; no property has a blank in its name."""
    return f"length of {name}"


def _places(
    path: Path, body: NDArray[np.uint8], element: Element, order: str
) -> Iterator[tuple[int, int, tuple[int, ...]]]:
    """Yield the first byte of each row, the byte after it, and the lengths of its lists."""
    content = body.data
    readers = {type_: struct.Struct(order + code) for type_, code in CODES.items()}
    stop = 0
    for _ in range(element.n_rows):
        start, lengths = stop, []
        for _, type_, length_type in element.properties:
            length = 1
            if length_type is not None:
                if stop + int(length_type[1]) > len(content):
                    raise incomplete(path, f"it ends in the middle of {element.name}")
                (value,) = readers[length_type].unpack_from(content, stop)
                if not 0 <= value <= len(content) or value % 1:
                    raise incomplete(path, f"a list in {element.name} cannot have {value:g} values")
                length = int(value)
                lengths.append(length)
                stop += int(length_type[1])
            stop += length * int(type_[1])
        if stop > len(content):
            raise incomplete(path, f"it ends in the middle of {element.name}")
        yield start, stop, tuple(lengths)


def _of_text(path: Path, data: bytes, at: int, element: Element) -> tuple[list[Table], int]:
    """The rows of an element of a text file, one on each line, and the position of the next element."""
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
    doubles = tuple(Property(name, "f8", length and "f8") for name, _, length in element.properties)
    found, used = _tables(path, numbers.view(np.uint8), element._replace(properties=doubles), "=")
    if used != numbers.nbytes:
        raise incomplete(path, f"its lines of {element.name} hold more than its header declares")
    return found, stop


def _in_order(parts: list[tuple[NDArray[np.intp], NDArray[Any]]]) -> NDArray[Any]:
    """The (n, k) values of several tables, each with the numbers of its rows, in the order of the rows."""
    if len(parts) == 1:
        return parts[0][1]
    numbers, values = (np.concatenate(part) for part in zip(*parts, strict=True))
    return np.asarray(values[np.argsort(numbers)])


# --- vertices and faces -----------------------------------------------------------------------------------


def _vertices(element: Element, found: list[Table]) -> RawScan:
    # Numbers of a text file are rounded to the precision of their type.
    scalars = {
        one.name: "f4" if one.type == "f4" else "f8" for one in element.properties if one.length is None
    }

    def columns(*names: str) -> NDArray[np.float64] | None:
        if not scalars.keys() >= {*names}:
            return None
        if not found:
            return np.empty((0, len(names)))
        parts = [
            (numbers, np.stack([rows[name].astype(scalars[name]) for name in names], axis=1))
            for numbers, rows in found
        ]
        return _in_order(parts).astype(np.float64)

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
    for numbers, rows in found:
        corners = rows[name]  # (p, k)
        if corners.dtype.kind == "f" and not ((np.abs(corners) <= LARGEST_INDEX) & (corners % 1 == 0)).all():
            raise incomplete(path, "its faces name vertices by other than whole numbers")
        alike.setdefault(corners.shape[1], []).append((numbers, corners))
    return fans([_in_order(parts) for parts in alike.values()])


def _ply_bytes(cloud: PointCloud) -> bytes:
    fields, table = columns_of(cloud, "x y z", "nx ny nz", "vp_x vp_y vp_z")
    properties = "".join(f"property double {field}\n" for field in fields)
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(table)}\n{properties}end_header\n"
    return header.encode() + table.astype("<f8").tobytes()


PLY = Format((".ply",), read_ply, write_cloud=_ply_bytes, write_mesh=partial(mesh_bytes, file_type="ply"))
