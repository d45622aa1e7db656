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
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from pcretrieve.errors import ScanReadError
from pcretrieve.formats.format import (
    Cut,
    Damaged,
    RawScan,
    fields_of,
    numbers_in,
    scan_of_fields,
)
from pcretrieve.values import PointCloud, polygon_triangles, strip_triangles

# Types of properties by the names of Stanford, of MeshLab, and of programs with indices of 64 bits.
NAMES = (
    "char=i1 uchar=u1 short=i2 ushort=u2 int=i4 uint=u4 long=i8 ulong=u8 float=f4 double=f8 int8=i1 uint8=u1 "
    "int16=i2 uint16=u2 int32=i4 uint32=u4 int64=i8 uint64=u8 float32=f4 float64=f8"
)
TYPES = dict(re.findall(r"(\w+)=(\w+)", NAMES))
BYTE_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}

FIRST_LINE = re.compile(rb"\A(?:\xef\xbb\xbf)?ply[ \t]*(\r?\n|\r)")
LAST_LINE = {b"\n": rb"\nend_header[ \t]*\r?\n", b"\r": rb"\rend_header[ \t]*\r"}

# Elements with faces: polygons, and strips of triangles with −1 between them.
STRIPS = "tristrips"
FACES = ("face", STRIPS)
FACE_PROPERTIES = ("vertex_indices", "vertex_index")
# Opacity below which a Gaussian splat is almost transparent: 10 %, which is stored as log(p / (1 − p)).
FAINT = -2.2
# Largest value of the types of an index.
LARGEST_INDEX = 2**32 - 1


class Property(NamedTuple):
    """A column of an element: one number, or a list of numbers if it has a type of their length."""

    name: str
    type: str
    length: str | None = None


class Element(NamedTuple):
    """A table of a file: its name, its number of rows, and its columns."""

    name: str
    n_rows: int
    properties: list[Property]


class Table(NamedTuple):
    """Rows of an element with equal lengths of lists: their (p,) numbers, and a (p,) array of records."""

    numbers: NDArray[np.intp]
    rows: NDArray[Any]


def read_ply(path: Path) -> RawScan:
    """Read a PLY file."""
    data = path.read_bytes()
    order, elements, at = _header(data)
    # Elements after the vertices and the faces are not read, such as the sampling grid of range scanners.
    while elements and not (elements[-1].name == "vertex" or _is_face(elements[-1])):
        elements.pop()
    if not order:
        # A row is a line: those of old Macs end with a return, and blank ones are no rows.
        data, at = re.sub(rb"[\r\n]\s*", b"\n", data[at:].lstrip()), 0
    scan = None
    faces: list[NDArray[np.int64]] = []
    for element in elements:
        if order:
            found, used = _tables(
                np.frombuffer(data, np.uint8, offset=at), element, order
            )
            at += used
        else:
            found, at = _of_text(data, at, element)
        if element.name == "vertex":
            scan = _vertices(element, found)
        elif _is_face(element):
            faces.append(_faces(element, found))
    if scan is None:
        raise ScanReadError(
            "a PLY scan must have an element 'vertex', this file has none"
        )
    return scan._replace(faces=np.concatenate(faces) if faces else None)


def _is_face(element: Element) -> bool:
    return element.name in FACES and element.n_rows > 0


# --- the header -------------------------------------------------------------------------------------------


def _header(data: bytes) -> tuple[str, list[Element], int]:
    """The byte order of a file, empty for text, its elements, and the position of the first row; bytes."""
    first = FIRST_LINE.match(data)
    if first is None:
        raise Damaged("its first line is not 'ply'")
    last = re.compile(LAST_LINE[first[1][-1:]]).search(data, first.start(1))
    if last is None:
        raise Damaged("its header has no line 'end_header'")
    order = None
    elements: list[Element] = []
    for line in data[first.end() : last.start()].decode("latin-1").splitlines():
        try:
            match line.split():
                case [] | ["comment" | "obj_info", *_]:
                    pass
                case ["format", name, "1.0"]:
                    order = BYTE_ORDERS[name.lower()]
                case ["element", name, number] if number.isdecimal() and all(
                    name != one.name for one in elements
                ):
                    # float, because int raises an exception for a number of thousands of digits.
                    n_rows, n_bytes = float(number), len(data) - last.end()
                    if n_rows > n_bytes:  # a row has at least one byte
                        raise Cut(
                            f"its header declares {n_rows:.0f} of {name}, {n_bytes} bytes follow"
                        )
                    elements.append(Element(name, int(n_rows), []))
                case ["property", "list", length, kind, name] if (
                    TYPES[length.lower()][0] != "f"
                ):
                    list_of = Property(name, TYPES[kind.lower()], TYPES[length.lower()])
                    elements[-1].properties.append(list_of)
                case ["property", kind, name]:
                    elements[-1].properties.append(Property(name, TYPES[kind.lower()]))
                case _:
                    raise LookupError
        except LookupError as error:
            raise Damaged(
                f"its header has the line '{' '.join(line.split())}'"
            ) from error
    if order is None:
        raise Damaged("its header has no line 'format'")
    return order, elements, last.end()


# --- the rows ---------------------------------------------------------------------------------------------


def _tables(
    body: NDArray[np.uint8], element: Element, order: str
) -> tuple[list[Table], int]:
    """The rows of an element in the (b,) bytes from its first row on, and where the next element begins."""
    n = element.n_rows
    no_row = 0, 0, (0,) * len(element.properties)
    _, width, lengths = next(_places(body, element, order), no_row)
    if n * width <= len(body):
        rows = body[: n * width].view(_record(element, order, lengths))
        stored = (
            rows[_length(one.name)]
            for one in element.properties
            if one.length is not None
        )
        if all((column == column[:1]).all() for column in stored):
            return [Table(np.arange(n), rows)], n * width
    alike: dict[tuple[int, ...], list[tuple[int, int, int]]] = {}
    stop = 0
    for number, (start, stop, lengths) in enumerate(_places(body, element, order)):
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
    for name, kind, length in element.properties:
        if length is None:
            fields.append((name, order + kind))
        else:
            fields += [
                (_length(name), order + length),
                (name, order + kind, (next(left),)),
            ]
    return np.dtype(fields)


def _length(name: str) -> str:
    """The field of the length of a list; no property has a blank in its name."""
    return f"length of {name}"


def _places(
    body: NDArray[np.uint8], element: Element, order: str
) -> Iterator[tuple[int, int, tuple[int, ...]]]:
    """Yield the first byte of each row, the byte after it, and the lengths of its lists."""
    columns = [
        (int(kind[1]), length and struct.Struct(order + np.dtype(length).char))
        for _, kind, length in element.properties
    ]
    content = body.data
    end = len(body)
    stop = 0
    for _ in range(element.n_rows):
        start, lengths = stop, []
        for size, reader in columns:
            length = 1
            if reader:
                if stop + reader.size > end:
                    raise Cut(f"it ends in the middle of {element.name}")
                (value,) = reader.unpack_from(content, stop)
                if not 0 <= value <= end or value % 1:
                    raise Damaged(
                        f"a list in {element.name} cannot have {value:g} values"
                    )
                length = int(value)
                lengths.append(length)
                stop += reader.size
            stop += length * size
        if stop > end:
            raise Cut(f"it ends in the middle of {element.name}")
        yield start, stop, tuple(lengths)


def _of_text(data: bytes, at: int, element: Element) -> tuple[list[Table], int]:
    """The rows of an element of a text file, one on each line, and the position of the next element."""
    ends = at + 1 + np.flatnonzero(np.frombuffer(data, np.uint8, offset=at) == ord("\n"))
    if element.n_rows > len(ends) + 1:
        raise Cut(
            f"it ends after {len(ends)} of {element.n_rows} lines of {element.name}"
        )
    stop = int(np.concatenate([[at], ends, [len(data)]])[element.n_rows])
    numbers = numbers_in(data[at:stop].decode("latin-1"), f"lines of {element.name}")
    doubles = [
        Property(name, "f8", length and "f8") for name, _, length in element.properties
    ]
    found, used = _tables(
        numbers.view(np.uint8), element._replace(properties=doubles), "="
    )
    if used != numbers.nbytes:
        raise Damaged(f"its lines of {element.name} hold more than its header declares")
    return found, stop


def _in_order(parts: list[tuple[NDArray[np.intp], NDArray[Any]]]) -> NDArray[Any]:
    """The (n, ...) values of several tables, each with the numbers of its rows, in the order of the rows."""
    if len(parts) == 1:
        return parts[0][1]
    numbers, values = (np.concatenate(part) for part in zip(*parts, strict=True))
    return values[np.argsort(numbers)]


# --- vertices and faces -----------------------------------------------------------------------------------


def _vertices(element: Element, found: list[Table]) -> RawScan:
    # Numbers of a text file are rounded to the precision of their type.
    types = {
        one.name: "f4" if one.type == "f4" else "f8"
        for one in element.properties
        if not one.length
    }

    def column(name: str) -> NDArray[Any]:
        return _in_order(
            [(numbers, rows[name].astype(types[name])) for numbers, rows in found]
        )

    scan = scan_of_fields([*types], column)
    if not {"opacity", "scale_0"} <= types.keys():
        return scan
    n_faint = int((column("opacity") < FAINT).sum())
    note = (
        f"{n_faint} of {element.n_rows} splats are almost transparent by their column opacity, and may float "
        "around the body: drop them, if so"
    )
    return scan._replace(notes=(note,) if n_faint else ())


def _faces(element: Element, found: list[Table]) -> NDArray[np.int64]:
    """(m, 3) vertex numbers of triangles."""
    lists = {
        one.name
        for one in element.properties
        if one.length is not None and one.type[0] != "f"
    }
    name = next((name for name in FACE_PROPERTIES if name in lists), None)
    if name is None:
        raise ScanReadError(
            f"the faces of a PLY scan must have the list {' or '.join(FACE_PROPERTIES)} of whole numbers"
        )
    if element.name == STRIPS:
        return np.concatenate(
            [strip_triangles(row) for _, rows in found for row in rows[name]]
        )
    polygons = [rows[name] for _, rows in found]  # (p, k) each
    for corners in polygons:
        if (
            corners.dtype.kind == "f"
            and not ((np.abs(corners) <= LARGEST_INDEX) & (corners % 1 == 0)).all()
        ):
            raise Damaged("its faces name vertices by other than whole numbers")
    return polygon_triangles(polygons)


def ply_bytes(cloud: PointCloud) -> bytes:
    """The content of a file of points, binary and in double precision."""
    fields, table = fields_of(cloud)
    properties = "".join(f"property double {field}\n" for field in fields)
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(table)}\n{properties}end_header\n"
    return header.encode() + table.astype("<f8").tobytes()
