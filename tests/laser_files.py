"""Files of laser scanners, by the libraries that are usual for them."""

from __future__ import annotations

import importlib.util
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

# What the tests need beside pcretrieve to write a file.
WRITERS = {".las": ("laspy",), ".laz": ("laspy", "lazrs"), ".e57": ("pye57",)}
CAN_WRITE = {
    suffix: all(importlib.util.find_spec(module) for module in modules) for suffix, modules in WRITERS.items()
}


def write_las(path: Path, points: Any, *, point_format: int = 3, classes: Sequence[int] = ()) -> None:
    """Points to a tenth of a millimetre, compressed if the file is named so."""
    import laspy

    header = laspy.LasHeader(point_format=point_format, version="1.4" if point_format > 5 else "1.2")
    header.scales, header.offsets = np.full(3, 1e-4), np.array([10.0, 20.0, 30.0])
    data = laspy.LasData(header)
    data.x, data.y, data.z = np.transpose(points)
    if classes:
        data.classification = np.array(classes)
    data.write(str(path))


def write_e57(path: Path, scans: Sequence[dict[str, Any]]) -> None:
    """Scans of the points (n, 3), with the arguments of pye57: name, rotation (w, x, y, z), translation."""
    import pye57

    with pye57.E57(str(path), "w") as file:
        for scan in scans:
            points = np.asarray(scan["points"], dtype=np.float64)
            columns = {f"cartesian{axis}": points[:, k] for k, axis in enumerate("XYZ")}
            columns |= {name: scan[name] for name in ("rowIndex", "columnIndex") if name in scan}
            pose = {name: scan[name] for name in ("name", "rotation", "translation") if name in scan}
            file.write_scan_raw(columns, **pose)


PAGE, CHECKSUM = 1024, 4  # of E57 files; bytes


def without_checksums(data: bytes) -> bytes:
    """The content of an E57 file."""
    return b"".join(data[k : k + PAGE - CHECKSUM] for k in range(0, len(data), PAGE))


def with_checksums(content: bytes, n_bytes: int) -> bytes:
    """An E57 file of that size, in which damage of the content is not found by its checksums alone."""
    size = PAGE - CHECKSUM
    whole = content[: n_bytes // PAGE * size].ljust(n_bytes // PAGE * size, b"\0")
    pages = (whole[k : k + size] for k in range(0, len(whole), size))
    return b"".join(page + _crc32c(page).to_bytes(CHECKSUM, "big") for page in pages)


def with_other_xml(data: bytes, change: Callable[[bytes], bytes]) -> bytes:
    """An E57 file, which must end with its XML part, with that part changed."""
    content = without_checksums(data)
    place, n_xml = struct.unpack_from("<QQ", content, 24)
    start = place // PAGE * (PAGE - CHECKSUM) + place % PAGE
    xml = change(content[start : start + n_xml])
    whole = bytearray(content[:start] + xml)
    size = PAGE * -(-len(whole) // (PAGE - CHECKSUM))
    struct.pack_into("<Q", whole, 16, size)
    struct.pack_into("<Q", whole, 32, len(xml))
    return with_checksums(bytes(whole), size)


def _crc32c(data: bytes) -> int:
    """The checksum of Castagnoli."""
    value = 0xFFFFFFFF
    for byte in data:
        value = value >> 8 ^ _CRC[(value ^ byte) & 0xFF]
    return value ^ 0xFFFFFFFF


def _crc_of_byte(byte: int) -> int:
    for _ in range(8):
        byte = byte >> 1 ^ (0x82F63B78 if byte & 1 else 0)
    return byte


_CRC = [_crc_of_byte(byte) for byte in range(256)]


def write_laser_scan(path: Path, points: Any) -> None:
    if path.suffix == ".e57":
        write_e57(path, [{"points": points, "translation": np.array([1.0, 2.0, 3.0])}])
    else:
        write_las(path, points, point_format=6 if path.suffix == ".laz" else 3)
