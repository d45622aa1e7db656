"""PCD, read by pypcd4, with the position of its sensor."""

from __future__ import annotations

import io
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import ScanReadError
from pcretrieve.scan.raw import RawScan, incomplete

__all__ = ["read_pcd"]

HEADER = re.compile(rb"\A(.*?^DATA[ \t]+(\w+)[ \t]*\r?\n)", re.MULTILINE | re.DOTALL)
PROMISE = re.compile(rb"^(?:POINTS|WIDTH)[ \t]+(\d+)", re.MULTILINE)

# LZF writes three bytes for 264 equal ones, and a point has at least one: what a header promises beyond this
# is not in the file.
MOST_POINTS_PER_BYTE = 88


def read_pcd(path: Path) -> RawScan:
    """Points with their normals and sensor positions.

    Sensors come from the fields ``vp_x vp_y vp_z`` where the file has them (PCL's PointWithViewpoint), else
    from the header's VIEWPOINT, which is in the frame of the points. Its default, the origin without a turn,
    is what programs write that know of no sensor, and is taken for none.
    """
    from pypcd4.pypcd4 import PointCloud

    try:
        content = PointCloud.from_fileobj(io.BytesIO(_checked(path)))  # type: ignore[arg-type]
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

    points = columns("x", "y", "z")
    if points is None:
        raise ScanReadError(f"a PCD scan must have the fields x y z, this one has {' '.join(content.fields)}")
    if len(points) != content.metadata.points:
        raise incomplete(path, f"it promises {content.metadata.points} points and holds {len(points)}")
    viewpoints = columns("vp_x", "vp_y", "vp_z")
    if viewpoints is None:
        pose = np.asarray(content.metadata.viewpoint, dtype=np.float64)  # (7,): tx ty tz qw qx qy qz
        if not np.array_equal(pose, [0, 0, 0, 1, 0, 0, 0]):
            viewpoints = pose[:3]
    return RawScan(points, None, columns("normal_x", "normal_y", "normal_z"), viewpoints)


def _checked(path: Path) -> bytes:
    """The file's bytes, if it can hold what it promises, before anything is allocated; text spaced evenly."""
    data = path.read_bytes()
    header = HEADER.match(data)
    if header is None:
        raise incomplete(path, "its header has no line DATA")
    # As a float: int refuses a number of thousands of digits.
    promised = max((float(count) for count in PROMISE.findall(header[1])), default=0)
    if promised > MOST_POINTS_PER_BYTE * len(data):
        raise incomplete(path, f"its header promises {promised:.0f} points, the file has {len(data)} bytes")
    if header[2] == b"ascii":
        # pypcd4 takes one space between numbers, and none behind the last.
        return b"\n".join(b" ".join(line.split()) for line in data.splitlines())
    return data
