"""The text format PTS: the number of points, then one point on each line."""

from __future__ import annotations

from pathlib import Path

from pcretrieve.formats.format import Format
from pcretrieve.formats.raw import RawScan, incomplete
from pcretrieve.formats.text import number_table, text_lines

__all__ = ["PTS", "read_pts"]


def read_pts(path: Path) -> RawScan:
    """Read a PTS file: the number of points, which may be missing, then ``x y z …`` on each line.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    RawScan
        The points; unit of the file.

    Raises
    ------
    ScanReadError
        If the file is not a text file, a line has too few numbers, or the number of points is wrong.
    """
    lines = text_lines(path)
    first = lines[0].split() if lines else []
    # float, because int raises an exception for a number of thousands of digits.
    promised = float(first[0]) if len(first) == 1 and first[0].isdecimal() else None
    points = number_table(lines if promised is None else lines[1:], n_columns=3)
    if promised is not None and promised != len(points):
        raise incomplete(path, f"its first line promises {promised:.0f} points, it holds {len(points)}")
    return RawScan(points)


PTS = Format((".pts",), read_pts)
