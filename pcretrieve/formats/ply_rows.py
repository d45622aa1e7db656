"""The rows of a PLY element, as tables of rows with equal lengths of lists.

Rows are stored without an index, and the length of a list may differ between rows.
In most files it does not: all rows are then one table, a numpy view of the file.
Otherwise the positions of the rows are found one after another.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from pcretrieve.formats.ply_header import Element
from pcretrieve.formats.raw import incomplete

__all__ = ["Table", "in_order", "tables"]

# Format characters of the module struct for the types of the length of a list; f8 is for text files.
CODES = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "f8": "d"}


class Table(NamedTuple):
    """Rows of an element with equal lengths of lists.

    numbers: (p,) int, numbers of the rows in the element.
    values: dict of str to (p, k) array, the values of each property; k is 1 for a property that is not a
        list.
    lengths: list of (p, 1) array, the lengths of each list, as stored in the file.
    """

    numbers: NDArray[np.intp]
    values: dict[str, NDArray[Any]]
    lengths: list[NDArray[Any]]


class Row(NamedTuple):
    """The first byte of a row, the byte after it, and the lengths of its lists."""

    start: int
    stop: int
    lengths: tuple[int, ...]


def tables(path: Path, body: NDArray[np.uint8], element: Element, order: str) -> tuple[list[Table], int]:
    """Read the rows of an element.

    body: (b,) uint8, the content of the file, from the first row on.
    Returns stop : int: position of the next element in `body`; bytes.
    """
    n = element.n_rows
    if not n:
        return [], 0
    first = next(_rows(path, body, element, order))
    stop = n * first.stop
    if stop <= len(body):
        block = body[:stop].reshape(n, first.stop)
        table = _table(np.arange(n), block, element, first.lengths, order)
        if all((lengths == lengths[0]).all() for lengths in table.lengths):
            return [table], stop
    alike: dict[tuple[int, ...], list[tuple[int, int, int]]] = {}
    for number, (start, stop, lengths) in enumerate(_rows(path, body, element, order)):
        alike.setdefault(lengths, []).append((number, start, stop - start))
    found = []
    for lengths, places in alike.items():
        numbers, starts, (width, *_) = np.array(places, dtype=np.intp).T
        block = sliding_window_view(body, width)[starts]
        found.append(_table(numbers, block, element, lengths, order))
    return found, stop


def in_order(parts: list[tuple[NDArray[np.intp], NDArray[Any]]]) -> NDArray[Any]:
    """Merge values of several tables in the order of the rows.

    parts: list of ((p,) int, (p, k) array), numbers of the rows, and their values, of each table.
    Returns (n, k) array: the values of all rows.
    """
    if len(parts) == 1:
        return parts[0][1]
    numbers, values = (np.concatenate(part) for part in zip(*parts, strict=True))
    ordered: NDArray[Any] = values[np.argsort(numbers)]
    return ordered


def _rows(path: Path, body: NDArray[np.uint8], element: Element, order: str) -> Iterator[Row]:
    """Yield the positions of the rows, one after another."""
    content = body.data
    readers = {type_: struct.Struct(order + code) for type_, code in CODES.items()}
    stop = 0
    for _ in range(element.n_rows):
        start, lengths = stop, []
        for _, type_, length_type in element.properties:
            length = 1
            if length_type is not None:
                if stop + _size(length_type) > len(content):
                    raise incomplete(path, f"it ends in the middle of {element.name}")
                (value,) = readers[length_type].unpack_from(content, stop)
                if not 0 <= value <= len(content) or value % 1:
                    raise incomplete(path, f"a list in {element.name} cannot have {value:g} values")
                length = int(value)
                lengths.append(length)
                stop += _size(length_type)
            stop += length * _size(type_)
        if stop > len(content):
            raise incomplete(path, f"it ends in the middle of {element.name}")
        yield Row(start, stop, tuple(lengths))


def _table(
    numbers: NDArray[np.intp],
    block: NDArray[np.uint8],
    element: Element,
    lengths: tuple[int, ...],
    order: str,
) -> Table:
    """A table of views of (p, w) bytes, without copies."""

    def view(start: int, stop: int, type_: str) -> NDArray[Any]:
        shape = (len(block), (stop - start) // _size(type_))
        found: NDArray[Any] = np.ndarray(shape, order + type_, block, start, (block.shape[1], _size(type_)))
        return found

    values, of_lists = {}, []
    left, stop = iter(lengths), 0
    for name, type_, length_type in element.properties:
        length = 1
        if length_type is not None:
            length = next(left)
            of_lists.append(view(stop, stop + _size(length_type), length_type))
            stop += _size(length_type)
        start, stop = stop, stop + length * _size(type_)
        values[name] = view(start, stop, type_)
    return Table(numbers, values, of_lists)


def _size(type_: str) -> int:
    """The number of bytes of a value."""
    return int(type_[1])
