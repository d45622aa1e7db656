"""The header of a PLY file [1]_.

A header declares elements (``vertex``, ``face``, others), the number of rows of each, and the properties of a
row: numbers, and lists of numbers that begin with their length.

References
----------
.. [1] Greg Turk, "The PLY Polygon File Format", 1994.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

from pcretrieve.formats.raw import incomplete

__all__ = ["Element", "Header", "Property", "read_header"]

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

FIRST_LINE = re.compile(rb"\Aply[ \t]*(\r?\n|\r)")
LAST_LINE = {b"\n": rb"\nend_header[ \t]*\r?\n", b"\r": rb"\rend_header[ \t]*\r"}


class Property(NamedTuple):
    """A column of an element: one number, or a list of numbers, in each row."""

    name: str
    type: str
    length: str | None


class Element(NamedTuple):
    """A table of a file: its name, its number of rows, and its columns."""

    name: str
    n_rows: int
    properties: tuple[Property, ...]

    def of_doubles(self) -> Element:
        """The element with all numbers, and lengths of lists, in double precision."""
        doubles = (Property(name, "f8", length and "f8") for name, _, length in self.properties)
        return self._replace(properties=tuple(doubles))


class Header(NamedTuple):
    """The declarations of a file.

    end: position of the first row; bytes.
    """

    order: str
    elements: tuple[Element, ...]
    end: int

    @property
    def is_text(self) -> bool:
        """Whether the file is a text file."""
        return not self.order


def read_header(path: Path, data: bytes) -> Header:
    """Read the header of a PLY file."""
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
                case ["property", "list", length, type_, name]:
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
    if added.length is not None and added.length[0] == "f":
        raise LookupError
    last = elements[-1]
    elements[-1] = last._replace(properties=(*last.properties, added))
