"""The format PCD, read by pypcd4, with the position of the sensor."""

from __future__ import annotations

import io
import re
import struct
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import ScanReadError
from pcretrieve.formats.columns import columns_of
from pcretrieve.formats.format import Format
from pcretrieve.formats.raw import RawScan, incomplete
from pcretrieve.values import PointCloud

if TYPE_CHECKING:
    from pypcd4.pypcd4 import MetaData

__all__ = ["PCD", "read_pcd"]

HEADER = re.compile(rb"\A.*?^DATA[ \t]+(\w+)[ \t]*\r?\n", re.MULTILINE | re.DOTALL)
# Number of lines after which pypcd4 ends a header without a line DATA.
MOST_HEADER_LINES = 10

# Largest compression ratio of LZF: 264 bytes in 3.
LZF_RATIO = 88
# Largest number of values of a point. The largest descriptor of PCL has 1980.
MOST_VALUES = 4096


def read_pcd(path: Path) -> RawScan:
    """Read a PCD file.

    Returns RawScan: points, and normals if there are any; unit of the file. The positions of the sensors are
        those of the fields ``vp_x vp_y vp_z`` (PCL's PointWithViewpoint), or else VIEWPOINT of the header,
        which is in the frame of the points. The default of VIEWPOINT, the origin without rotation, is written
        by programs that do not know the sensor, and is ignored.
    """
    from pypcd4.pypcd4 import MetaData
    from pypcd4.pypcd4 import PointCloud as Pcd

    data = path.read_bytes()
    header = HEADER.match(data)
    if header is None:
        raise incomplete(path, "its header has no line DATA")
    if header[1] == b"ascii":
        # pypcd4 accepts single spaces between numbers only, and none at the end of a line.
        data = b"\n".join(b" ".join(line.split()) for line in data.splitlines())
    try:
        lines, start = _header_lines(data)
        _check_promises(path, MetaData.parse_header(lines), memoryview(data)[start:])
        content = Pcd.from_fileobj(io.BytesIO(data))  # type: ignore[arg-type]
    except (ScanReadError, MemoryError):
        raise
    # pypcd4 has no exception class: damaged files raise exceptions of numpy, pydantic or the decompressor.
    except Exception as error:
        raise incomplete(path, error) from error

    def columns(*names: str) -> NDArray[np.float64] | None:
        if not set(names) <= set(content.fields):
            return None
        return np.asarray(content.numpy(names), dtype=np.float64).reshape(-1, 3)

    points = columns("x", "y", "z")
    if points is None:
        raise ScanReadError(f"a PCD scan must have the fields x y z, this one has {' '.join(content.fields)}")
    if len(points) != content.metadata.points:
        raise incomplete(path, f"it declares {content.metadata.points} points and holds {len(points)}")
    viewpoints = columns("vp_x", "vp_y", "vp_z")
    if viewpoints is None:
        pose = np.asarray(content.metadata.viewpoint, dtype=np.float64)  # (7,): tx ty tz qw qx qy qz
        if not np.array_equal(pose, [0, 0, 0, 1, 0, 0, 0]):
            viewpoints = pose[:3]
    return RawScan(points, None, columns("normal_x", "normal_y", "normal_z"), viewpoints)


def _header_lines(data: bytes) -> tuple[list[str], int]:
    """The lines of the header, as pypcd4 splits them, and the position of the points; bytes."""
    lines: list[str] = []
    start = 0
    for line in io.BytesIO(data):
        start += len(line)
        text = line.decode("utf-8").strip()
        if text and not text.startswith("#"):
            lines.append(text)
            if text.startswith("DATA") or len(lines) >= MOST_HEADER_LINES:
                break
    return lines, start


def _check_promises(path: Path, header: MetaData, body: memoryview) -> None:
    """Check, before arrays are allocated, that the file is large enough for its header."""
    n_values = sum(header.count)
    if n_values > MOST_VALUES:
        raise incomplete(path, f"its header declares {n_values} values a point, {MOST_VALUES} may be")
    n_bytes = header.points * sum(size * count for size, count in zip(header.size, header.count, strict=True))
    most = len(body)
    if header.data.value.startswith("binary") and header.data.value != "binary":
        compressed, uncompressed = struct.unpack_from("<II", body)
        if compressed > len(body) - 8 or uncompressed > LZF_RATIO * compressed:
            raise incomplete(
                path, f"it declares {uncompressed} bytes in {compressed}, {len(body) - 8} follow"
            )
        most = uncompressed
    if header.data.value != "ascii" and n_bytes > most:
        raise incomplete(path, f"its header declares {header.points} points, {most} bytes follow")


def _pcd_bytes(cloud: PointCloud) -> bytes:
    # The point types of PCL are of single precision, and its programs expect such files.
    fields, table = columns_of(cloud, "x y z", "normal_x normal_y normal_z", "vp_x vp_y vp_z")
    n = len(table)

    def repeated(word: str) -> str:
        return " ".join([word] * len(fields))

    header = (
        "# .PCD v0.7 - Point Cloud Data file format\n"
        f"VERSION 0.7\nFIELDS {' '.join(fields)}\nSIZE {repeated('4')}\nTYPE {repeated('F')}\n"
        f"COUNT {repeated('1')}\nWIDTH {n}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA binary\n"
    )
    return header.encode() + table.astype("<f4").tobytes()


PCD = Format((".pcd",), read_pcd, write_cloud=_pcd_bytes)
