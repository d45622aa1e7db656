"""What a PLY file declares about its content.

A header names elements (``vertex``, ``face``, others), the number of rows of each, and the properties that a
row holds: numbers, and lists that begin with their length. Greg Turk, "The PLY Polygon File Format", 1994.
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
    """One value of each row, or a list of values.

    Attributes
    ----------
    name : str
    type : str
        Of a value, as numpy names it: ``f4``.
    length : str or None
        Type of the length in front of a list; None for a single value.
    """

    name: str
    type: str
    length: str | None


class Element(NamedTuple):
    """A table: its number of rows, and what each row holds."""

    name: str
    n_rows: int
    properties: tuple[Property, ...]

    def of_doubles(self) -> Element:
        """The same with all numbers, lengths of lists too, in double precision."""
        doubles = (Property(name, "f8", length and "f8") for name, _, length in self.properties)
        return self._replace(properties=tuple(doubles))


class Header(NamedTuple):
    """What a file declares.

    Attributes
    ----------
    order : str
        Byte order of a binary file, as numpy writes it: ``<`` or ``>``; empty for a text.
    elements : tuple of Element
    end : int
        Where the rows begin; bytes.
    """

    order: str
    elements: tuple[Element, ...]
    end: int

    @property
    def is_text(self) -> bool:
        return not self.order


def read_header(path: Path, data: bytes) -> Header:
    """Read the header of a PLY file.

    Parameters
    ----------
    path : Path
        For messages.
    data : bytes
        The whole file.

    Raises
    ------
    ScanReadError
        If there is no such header, or the file is too short for the rows that it declares.
    """
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
    """The number of rows, if there can be that many: a row takes one byte at least."""
    if not number.isdecimal():
        raise LookupError
    # As a float: int refuses a number of thousands of digits.
    if float(number) > n_bytes:
        raise incomplete(path, f"its header promises {float(number):.0f} of {name}, {n_bytes} bytes follow")
    return int(number)


def _append(elements: list[Element], added: Property) -> None:
    if added.length is not None and added.length[0] == "f":
        raise LookupError
    last = elements[-1]
    elements[-1] = last._replace(properties=(*last.properties, added))
