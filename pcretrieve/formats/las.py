"""The formats LAS [1]_ and LAZ of laser scanners, in metres.

The header and the points of LAS files are read here, because laspy follows what a damaged header declares, up
to four thousand million records. Points of LAZ files are decompressed by lazrs.

References
----------
.. [1] American Society for Photogrammetry and Remote Sensing, "LAS Specification 1.4 – R15", 2019.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.arrays import FloatArray
from pcretrieve.errors import ScanReadError
from pcretrieve.formats.format import Extra, Format
from pcretrieve.formats.laz import laszip_record, unpacked
from pcretrieve.formats.raw import RawScan, incomplete

__all__ = ["LAS", "LAZ", "read_las"]

SIGNATURE = b"LASF"
HEADER_BYTES = {
    2: 227,
    3: 235,
    4: 375,
}  # by the minor version; that of 1.0 and 1.1 is the same as that of 1.2
# Sizes of the records of the point formats 0 to 10; bytes.
RECORD_BYTES = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)
# Bits of the point format that mark compression.
COMPRESSED = 0xC0
# Point formats from this one on have a byte for the class, at byte 16; older ones five bits of byte 15.
FIRST_OF_NEW = 6
# Classes of points that are not on a surface: low noise, high noise.
NOISE = (7, 18)


class Header(NamedTuple):
    """The declarations of a header about the points."""

    start: int  # of the points; bytes
    n_points: int
    point_format: int
    record_bytes: int
    scale: FloatArray  # (3,)
    shift: FloatArray  # (3,)
    laszip: bytes | None  # the record that says how the points are compressed, if they are


def read_las(path: Path) -> RawScan:
    """Read a LAS or LAZ file."""
    data = path.read_bytes()
    try:
        header = _header(data)
        if header.laszip is None:
            records = _plain(data, header)
        else:
            _need_lazrs()
            records = unpacked(data, header.start, header.laszip, header.n_points, header.record_bytes)
    except struct.error as error:
        raise incomplete(path, "its header is cut short") from error
    except (ValueError, OverflowError) as error:
        raise incomplete(path, error) from error
    # A view of the records, of which the first three numbers are the coordinates.
    stored = np.ndarray((len(records), 3), "<i4", records.data, 0, (header.record_bytes, 4))
    points = stored * header.scale + header.shift
    new = header.point_format >= FIRST_OF_NEW
    noise = np.isin(records[:, 16] if new else records[:, 15] & 0x1F, NOISE)  # (n,)
    if not noise.any():
        return RawScan(points, unit="m")
    note = f"dropped {int(noise.sum())} of {len(points)} points that the file classifies as noise"
    return RawScan(points[~noise], notes=(note,), unit="m")


def _header(data: bytes) -> Header:
    if data[:4] != SIGNATURE or len(data) < HEADER_BYTES[2]:
        raise ValueError("its first bytes are not those of LAS")
    major, minor = data[24], data[25]
    size, start, n_records = struct.unpack_from("<HII", data, 94)
    code, record_bytes, n_points = struct.unpack_from("<BHI", data, 104)
    if major != 1 or size < HEADER_BYTES.get(max(minor, 2), HEADER_BYTES[4]):
        raise ValueError(f"its header says version {major}.{minor}, {size} bytes")
    if minor >= 4:
        (n_points,) = struct.unpack_from("<Q", data, 247)
    point_format = code & ~COMPRESSED
    if point_format >= len(RECORD_BYTES) or record_bytes < RECORD_BYTES[point_format]:
        raise ValueError(f"its points have {record_bytes} bytes, and the format {point_format}")
    if not size <= start <= len(data):
        raise ValueError(f"its points begin at byte {start}, it has {len(data)}")
    scale, shift = np.frombuffer(data, "<f8", 6, 131).reshape(2, 3)
    if not np.isfinite([scale, shift]).all():
        raise ValueError("its scale is not finite")
    laszip = laszip_record(data[size:start], n_records) if code & COMPRESSED else None
    return Header(start, n_points, point_format, record_bytes, scale, shift, laszip)


def _plain(data: bytes, header: Header) -> NDArray[np.uint8]:
    """(n, b) bytes of the points."""
    promised = header.n_points * header.record_bytes
    if promised > len(data) - header.start:
        raise ValueError(
            f"its header declares {header.n_points} points, {len(data) - header.start} bytes follow"
        )
    return np.frombuffer(data, np.uint8, promised, header.start).reshape(-1, header.record_bytes)


def _need_lazrs() -> None:
    """Check that a file named .las, whose points are compressed all the same, can be read."""
    if LAZ.extra is not None and LAZ.extra.missing:
        raise ScanReadError(f"its points are compressed, which needs lazrs: {LAZ.extra.command}")


LAS = Format((".las",), read_las)
LAZ = Format((".laz",), read_las, extra=Extra("las", ("lazrs",)))
