"""The format E57 [1]_ of terrestrial scanners, read by pye57: scans with the poses of sensors, in metres.

References
----------
.. [1] ASTM E2807-11, "Standard Specification for 3D Imaging Data Exchange", 2011.
"""

from __future__ import annotations

import os
import re
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pcretrieve.errors import ScanReadError
from pcretrieve.formats.format import (
    Extra,
    Format,
    RawScan,
    distinct_names,
    incomplete,
    joined,
    without_zeros,
)
from pcretrieve.values import FloatArray

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


class ScanHeader(NamedTuple):
    """What a file says of one of its scans.

    position: (3,) float64 or None, position of the sensor in the frame of the file; None if the scan has no
        pose.
    """

    name: str
    n_points: int
    position: FloatArray | None
    is_grid: bool


def read_e57(path: Path, name: str | None = None) -> RawScan:
    """Read the scans in an E57 file as one, or the scan of a name."""
    _check_xml(path)
    with _opened(path) as file:
        headers = _headers(path, file)
        numbers = range(len(headers)) if name is None else [_names_of(headers).index(name)]
        return joined([_scan(file, number, headers[number]) for number in numbers])


def _names(path: Path) -> tuple[str, ...]:
    _check_xml(path)
    with _opened(path) as file:
        return tuple(_names_of(_headers(path, file)))


def _names_of(headers: list[ScanHeader]) -> list[str]:
    return distinct_names(header.name for header in headers)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """The open file; exceptions of libE57 and pye57, which are of several classes, say that it is damaged."""
    import pye57

    try:
        # As bytes, because a name need not be UTF-8.
        with pye57.E57(os.fsencode(path)) as file:
            yield file
    except (MemoryError, ScanReadError):
        raise
    except Exception as error:
        raise incomplete(path, error) from error


def _headers(path: Path, file: Any) -> list[ScanHeader]:
    """The headers of the scans, whose sizes are checked before the scans are read."""
    headers = []
    n_bits = 8 * path.stat().st_size
    for number in range(file.scan_count):
        header = file.get_header(number)
        name = header["name"].value() if header.node.isDefined("name") else ""
        position = np.asarray(header.translation, dtype=np.float64) if header.has_pose() else None
        is_grid = {"rowIndex", "columnIndex"} <= {*header.point_fields}
        if int(header.point_count) * FEWEST_BITS > n_bits:
            raise incomplete(path, f"it declares {header.point_count} points in {n_bits // 8} bytes")
        if position is not None and not np.isfinite(position).all():
            raise incomplete(path, "the position of a sensor is not finite")
        headers.append(ScanHeader(str(name), int(header.point_count), position, is_grid))
    if not headers:
        raise ScanReadError("the file holds no scans")
    return headers


def _scan(file: Any, number: int, header: ScanHeader) -> RawScan:
    """The points of a scan in the frame of the file, without those that the file marks as invalid."""
    data = file.read_scan(number, ignore_missing_fields=True)
    points = np.column_stack([data[f"cartesian{axis}"] for axis in "XYZ"]).astype(np.float64)
    # The default pose, at the origin, is that of a sensor if the points are the grid that it measured.
    known = header.position is not None and (header.is_grid or header.position.any())
    return without_zeros(RawScan(points, viewpoints=header.position if known else None, unit="m"))


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


E57 = Format((".e57",), read_e57, names=_names, extra=Extra("e57", ("pye57",)))
