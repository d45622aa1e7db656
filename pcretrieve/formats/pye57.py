"""Scans of E57 files, by pye57."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pcretrieve.arrays import FloatArray

__all__ = ["ScanHeader", "scan_headers", "scan_points"]


class ScanHeader(NamedTuple):
    """What a file says of one of its scans.

    position: (3,) float64 or None, position of the sensor in the frame of the file; None if the scan has no
        pose.
    """

    name: str
    n_points: int
    position: FloatArray | None
    is_grid: bool


def scan_headers(path: Path) -> list[ScanHeader]:
    """The headers of the scans in a file."""
    with _opened(path) as file:
        headers = []
        for number in range(file.scan_count):
            header = file.get_header(number)
            name = header["name"].value() if header.node.isDefined("name") else ""
            position = np.asarray(header.translation, dtype=np.float64) if header.has_pose() else None
            is_grid = {"rowIndex", "columnIndex"} <= {*header.point_fields}
            headers.append(ScanHeader(str(name), int(header.point_count), position, is_grid))
        return headers


def scan_points(path: Path, number: int) -> FloatArray:
    """The points of a scan, without those that the file marks as invalid.

    Returns (n, 3) float64: in the frame of the file; metres.
    """
    with _opened(path) as file:
        data = file.read_scan(number, ignore_missing_fields=True)
        return np.column_stack([data[f"cartesian{axis}"] for axis in "XYZ"]).astype(np.float64)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """The open file; exceptions are raised as ValueError, because libE57 and pye57 have several."""
    import pye57

    try:
        # As bytes, because a name need not be UTF-8.
        with pye57.E57(os.fsencode(path)) as file:
            yield file
    except MemoryError:
        raise
    except Exception as error:
        raise ValueError(str(error) or type(error).__name__) from error
