"""The text format PTX of terrestrial scanners: grids of readings, each with the pose of the sensor."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np

from pcretrieve.errors import ScanReadError
from pcretrieve.formats.format import Damaged, RawScan, joined
from pcretrieve.formats.organised import organised_scan
from pcretrieve.formats.text import number_rows
from pcretrieve.values import FloatArray

# Lines of a header: columns, rows, the sensor and its three axes, and a matrix of four lines.
N_HEADER_LINES = 10
# Size of the shortest row, "0 0 0" and the end of the line; bytes.
SHORTEST_ROW = 6
# Largest difference of the rotation of a pose from an orthogonal matrix: files have six digits.
POSE_TOLERANCE = 1e-3


class Header(NamedTuple):
    """The size of a grid, and the motion from the frame of its sensor to that of the file."""

    n_columns: int
    n_rows: int
    rotation: FloatArray  # (3, 3), for points in rows: p' = p R + t
    translation: FloatArray  # (3,)


def read_ptx(path: Path, name: str | None = None) -> RawScan:
    """Read the scans in a PTX file as one, or the scan of a number.

    The points are in the common frame of the file, with normals and the position of the sensor of each point.
    Readings without an answer, which are zeros, are dropped with a note.
    """
    scans = []
    # Bytes that are no text are no numbers either, and are reported as such.
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        for number, header in enumerate(_headers(path, file), start=1):
            if name in (None, str(number)):
                scans.append(_scan(file, header))
            else:
                _pass_over(file, header)
    return joined(scans)


def ptx_names(path: Path) -> tuple[str, ...]:
    """The numbers of the scans in a file."""
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        names = []
        for number, header in enumerate(_headers(path, file), start=1):
            names.append(str(number))
            _pass_over(file, header)
    return tuple(names)


def _pass_over(file: IO[str], header: Header) -> None:
    for _ in islice(file, header.n_columns * header.n_rows):
        pass


def _headers(path: Path, file: IO[str]) -> Iterator[Header]:
    """Yield the header of each scan. The caller must read the rows before the next header."""
    size, first = path.stat().st_size, True
    while lines := [line for line in islice(file, N_HEADER_LINES) if first or line.strip()]:
        first = False
        try:
            numbers = [[float(word) for word in line.split()] for line in lines]
            (n_columns,), (n_rows,) = numbers[:2]
            pose = np.array(numbers[6:])
            if len(lines) < N_HEADER_LINES or pose.shape != (4, 4) or not np.isfinite(pose).all():
                raise ValueError("it must be ten lines, of which the last four are a matrix")
            if not (n_columns.is_integer() and n_rows.is_integer() and min(n_columns, n_rows) > 0):
                raise ValueError(f"the size of the grid must be whole numbers, got {n_columns:g} {n_rows:g}")
            if n_columns * n_rows * SHORTEST_ROW > size:
                raise ValueError(f"it declares {n_columns * n_rows:.0f} rows in {size} bytes")
            rotation = pose[:3, :3]
            if np.abs(rotation @ rotation.T - np.eye(3)).max() > POSE_TOLERANCE:
                raise ValueError("the matrix is not a rigid motion")
        except ValueError as error:
            raise Damaged(f"its header is damaged: {error}") from error
        yield Header(int(n_columns), int(n_rows), rotation, pose[3, :3])


def _scan(file: IO[str], header: Header) -> RawScan:
    n = header.n_columns * header.n_rows
    table = number_rows(islice(file, n), (0, 1, 2))
    if len(table) != n:
        raise Damaged(f"its header declares {n} points, it holds {len(table)}")
    measured = np.isfinite(table).all(axis=1) & table.any(axis=1)  # (n,)
    points = table @ header.rotation + header.translation
    size = header.n_columns, header.n_rows
    try:
        return organised_scan(points.reshape(*size, 3), measured.reshape(size), header.translation)
    except ScanReadError as error:
        raise ScanReadError(f"a scan of {size[0]} × {size[1]} readings: {error.message}") from error
