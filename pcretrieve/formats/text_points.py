"""Text files with one point on each line: XYZ, XYZN, XYZRGB, PTS, ASC, CSV, TXT."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterable
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import InputError, ScanReadError
from pcretrieve.formats.format import Format
from pcretrieve.formats.raw import RawScan, are_normals, incomplete, without_zeros
from pcretrieve.formats.text_layout import Layout, find_layout, looks_like_points
from pcretrieve.values import PointCloud

__all__ = ["TEXT_FORMATS", "number_rows", "read_text_points"]

# Significant digits, sufficient for single precision.
DIGITS = 9


def read_text_points(path: Path, *, normals: bool | None = None) -> RawScan:
    """Read a table of points.

    normals: whether the fourth to the sixth column, of a file whose header does not name its columns, hold
        the normals. By default, if all of them have unit length.
    Returns RawScan: the points, and their normals if there are any; unit of the file. Rows of zeros are
        dropped with a note.
    """
    layout = find_layout(path, n_numbers=6 if normals else 3)
    columns = layout.points + (layout.normals or ())
    if not layout.named and (normals or (normals is None and layout.n_columns >= 6)):
        columns = (0, 1, 2, 3, 4, 5)
    table = _table(path, columns, layout)
    if layout.promised is not None and layout.promised != len(table):
        raise incomplete(path, f"it declares {layout.promised:.0f} points and holds {len(table)}")
    keep = len(columns) == 6 and (layout.named or normals or are_normals(table[:, 3:]))
    return without_zeros(RawScan(table[:, :3], normals=table[:, 3:] if keep else None))


def number_rows(
    lines: Iterable[str], columns: tuple[int, ...], separator: str | None = None
) -> NDArray[np.float64]:
    """Columns of a table of numbers.

    Returns (n, c) float64: the numbers.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # an empty table is reported by `read_scan`
            table = np.loadtxt(lines, dtype=np.float64, usecols=columns, delimiter=separator, ndmin=2)
    except ValueError as error:
        raise ScanReadError(f"each line must hold {max(columns) + 1} numbers: {error}") from error
    return table.reshape(-1, len(columns))


def _table(path: Path, columns: tuple[int, ...], layout: Layout) -> NDArray[np.float64]:
    with path.open(encoding=layout.encoding, errors="replace") as file:
        for _ in range(layout.n_header_lines):
            next(file)
        # NumPy parses the lines as the file gives them, so that its text is never in memory as a whole.
        lines = file if layout.decimal == "." else (line.replace(layout.decimal, ".") for line in file)
        return number_rows(lines, columns, layout.separator)


def _xyzn_bytes(cloud: PointCloud) -> bytes:
    if cloud.normals is None:
        raise InputError(
            "an .xyzn file must hold normals, these points have none: write .ply, or estimate them"
        )
    text = io.BytesIO()
    np.savetxt(text, np.concatenate([cloud.points, cloud.normals], axis=1), fmt=f"%.{DIGITS}g")
    return text.getvalue()


TEXT_FORMATS = (
    # Columns behind the coordinates of these formats are colours and intensities.
    Format((".xyz", ".xyzrgb", ".pts"), partial(read_text_points, normals=False)),
    Format((".xyzn",), partial(read_text_points, normals=True), write_cloud=_xyzn_bytes),
    # Files of these suffixes hold other tables and texts too.
    Format((".asc", ".csv", ".txt"), read_text_points, recognise=looks_like_points),
)
