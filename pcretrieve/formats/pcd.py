"""PCD, read by pypcd4, with the position of its sensor."""

from __future__ import annotations

import io
import re
import struct
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import ScanReadError
from pcretrieve.formats.raw import RawScan, incomplete

if TYPE_CHECKING:
    from pypcd4.pypcd4 import MetaData

__all__ = ["read_pcd"]

HEADER = re.compile(rb"\A.*?^DATA[ \t]+(\w+)[ \t]*\r?\n", re.MULTILINE | re.DOTALL)
# Where pypcd4 takes a header to end that has no line DATA.
MOST_HEADER_LINES = 10

# LZF writes three bytes for 264 equal ones, and never fewer.
LZF_RATIO = 88
# The longest descriptor that PCL stores with each point has 1980 values.
MOST_VALUES = 4096


def read_pcd(path: Path) -> RawScan:
    """Read a PCD file.

    Parameters
    ----------
    path : Path

    Returns
    -------
    RawScan
        Points with their normals and sensor positions. Sensors come from the fields ``vp_x vp_y vp_z`` where
        the file has them (PCL's PointWithViewpoint), else from the header's VIEWPOINT, which is in the frame
        of the points. Its default, the origin without a rotation, is what programs write that know of no
        sensor, and stands for none.

    Raises
    ------
    ScanReadError
        If it is not a PCD file, is cut short, or has no fields ``x y z``.
    """
    from pypcd4.pypcd4 import MetaData, PointCloud

    data = path.read_bytes()
    header = HEADER.match(data)
    if header is None:
        raise incomplete(path, "its header has no line DATA")
    if header[1] == b"ascii":
        # pypcd4 takes one space between numbers, and none behind the last.
        data = b"\n".join(b" ".join(line.split()) for line in data.splitlines())
    try:
        lines, start = _header_lines(data)
        _check_promises(path, MetaData.parse_header(lines), memoryview(data)[start:])
        content = PointCloud.from_fileobj(io.BytesIO(data))  # type: ignore[arg-type]
    except (ScanReadError, MemoryError):
        raise
    # pypcd4 has no exception of its own: a broken header or body surfaces as whatever numpy, its header
    # grammar (pydantic) or its decompressor met.
    except Exception as error:
        raise incomplete(path, error) from error

    def columns(*names: str) -> NDArray[np.float64] | None:
        if not set(names) <= set(content.fields):
            return None
        return np.asarray(content.numpy(names), dtype=np.float64).reshape(-1, 3)

    # Any bytes may be coordinates, also such as overflow; they are checked later.
    with np.errstate(all="ignore"):
        points = columns("x", "y", "z")
        normals = columns("normal_x", "normal_y", "normal_z")
        viewpoints = columns("vp_x", "vp_y", "vp_z")
    if points is None:
        raise ScanReadError(f"a PCD scan must have the fields x y z, this one has {' '.join(content.fields)}")
    if len(points) != content.metadata.points:
        raise incomplete(path, f"it promises {content.metadata.points} points and holds {len(points)}")
    if viewpoints is None:
        pose = np.asarray(content.metadata.viewpoint, dtype=np.float64)  # (7,): tx ty tz qw qx qy qz
        if not np.array_equal(pose, [0, 0, 0, 1, 0, 0, 0]):
            viewpoints = pose[:3]
    return RawScan(points, None, normals, viewpoints)


def _header_lines(data: bytes) -> tuple[list[str], int]:
    """The lines that pypcd4 takes for the header, and where the points begin; bytes."""
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
    """Check, before anything is allocated, that the file can hold what its header promises.

    Raises
    ------
    ScanReadError
        If it cannot.
    """
    n_values = sum(header.count)
    if n_values > MOST_VALUES:
        raise incomplete(path, f"its header promises {n_values} values a point, {MOST_VALUES} may be")
    n_bytes = header.points * sum(size * count for size, count in zip(header.size, header.count, strict=True))
    most = len(body)
    if header.data.value.startswith("binary") and header.data.value != "binary":
        compressed, uncompressed = struct.unpack_from("<II", body)
        if compressed > len(body) - 8 or uncompressed > LZF_RATIO * compressed:
            raise incomplete(
                path, f"it promises {uncompressed} bytes in {compressed}, {len(body) - 8} follow"
            )
        most = uncompressed
    if header.data.value != "ascii" and n_bytes > most:
        raise incomplete(path, f"its header promises {header.points} points, {most} bytes follow")
