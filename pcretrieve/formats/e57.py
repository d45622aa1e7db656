"""The format E57 [1]_ of terrestrial scanners, read by pye57: scans with the poses of sensors, in metres.

References
----------
.. [1] ASTM E2807-11, "Standard Specification for 3D Imaging Data Exchange", 2011.
"""

from __future__ import annotations

import re
import struct
from pathlib import Path

import numpy as np

from pcretrieve.errors import ScanReadError
from pcretrieve.formats.format import Extra, Format
from pcretrieve.formats.members import Members, distinct_names
from pcretrieve.formats.pye57 import ScanHeader, scan_headers, scan_points
from pcretrieve.formats.raw import RawScan, incomplete, joined, without_zeros

__all__ = ["E57", "read_e57"]

# Fewest bits of a point in a file: its three coordinates cannot all be constant.
FEWEST_BITS = 1

# Pages of a file, each with a checksum at its end; bytes. In the header: where the XML part begins in the
# file, and its size without checksums.
PAGE, CHECKSUM = 1024, 4
XML = struct.Struct("<24xQQ")

# Beginning of the XML part: E57 requires UTF-8, in which declarations of entities can be found.
UTF_8 = re.compile(
    rb"""(\xef\xbb\xbf)?\s*(<\?xml\s+version\s*=\s*['"]1\.[01]['"](\s+encoding\s*=\s*['"]utf-8['"])?"""
    rb"""(\s+standalone\s*=\s*['"](yes|no)['"])?\s*\?>)?\s*<[a-z!]""",
    re.IGNORECASE,
)


def read_e57(path: Path, name: str | None = None) -> RawScan:
    """Read an E57 file."""
    headers = _headers(path)
    numbers = range(len(headers)) if name is None else [_names_of(headers).index(name)]
    try:
        return joined([_scan(path, number, headers[number]) for number in numbers])
    except ValueError as error:
        raise incomplete(path, error) from error


def _scan(path: Path, number: int, header: ScanHeader) -> RawScan:
    points = scan_points(path, number)
    known = header.position is not None and (header.is_grid or header.position.any())
    return without_zeros(RawScan(points, viewpoints=header.position if known else None, unit="m"))


def _members(path: Path) -> tuple[str, ...]:
    return tuple(_names_of(_headers(path)))


def _names_of(headers: list[ScanHeader]) -> list[str]:
    return distinct_names(header.name for header in headers)


def _headers(path: Path) -> list[ScanHeader]:
    """The headers of the scans, whose sizes are checked before the scans are read."""
    _check_xml(path)
    try:
        headers = scan_headers(path)
    except ValueError as error:
        raise incomplete(path, error) from error
    if not headers:
        raise ScanReadError("the file holds no scans")
    n_bits = 8 * path.stat().st_size
    for header in headers:
        if header.n_points * FEWEST_BITS > n_bits:
            raise incomplete(path, f"it declares {header.n_points} points in {n_bits // 8} bytes")
        if header.position is not None and not np.isfinite(header.position).all():
            raise incomplete(path, "the position of a sensor is not finite")
    return headers


def _check_xml(path: Path) -> None:
    """Refuse XML with a document type, whose entities pye57 would fetch from any file and address."""
    with path.open("rb") as file:
        head = file.read(XML.size)
        if len(head) < XML.size:
            raise incomplete(path, "its header is cut short")
        start, n_bytes = XML.unpack(head)
        if start + n_bytes > path.stat().st_size:
            raise incomplete(path, "its XML part is cut short")
        file.seek(start // PAGE * PAGE)
        pages = iter(lambda: file.read(PAGE)[:-CHECKSUM], b"")
        before, content = start % PAGE, bytearray()
        while len(content) < before + n_bytes and (page := next(pages, b"")):
            content += page
    xml = content[before : before + n_bytes]
    if not UTF_8.match(xml):
        raise incomplete(path, "its XML part is not UTF-8")
    if re.search(rb"<!(doctype|entity)", xml, re.IGNORECASE):
        raise ScanReadError("its XML part has a document type, which E57 does not allow: export it again")


E57 = Format((".e57",), read_e57, members=Members(_members, read_e57), extra=Extra("e57", ("pye57",)))
