"""The text formats XYZ, XYZN and PTS: one point on each line."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import ScanReadError
from pcretrieve.formats.raw import RawScan, incomplete

__all__ = ["read_pts", "read_xyz", "read_xyzn", "text_lines"]


def read_xyz(path: Path) -> RawScan:
    """Read an XYZ file: ``x y z`` on each line; further columns are ignored.

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
        If the file is not a text file, or a line has too few numbers.
    """
    return RawScan(_table(path, n_columns=3))


def read_xyzn(path: Path) -> RawScan:
    """Read an XYZN file: ``x y z nx ny nz`` on each line.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    RawScan
        The points and their normals; unit of the file.

    Raises
    ------
    ScanReadError
        If the file is not a text file, or a line has too few numbers.
    """
    table = _table(path, n_columns=6)
    return RawScan(table[:, :3], normals=table[:, 3:])


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
    points = _table(path, n_columns=3, skip=0 if promised is None else 1)
    if promised is not None and promised != len(points):
        raise incomplete(path, f"its first line promises {promised:.0f} points, it holds {len(points)}")
    return RawScan(points)


def text_lines(path: Path) -> list[str]:
    """The lines of a text file.

    Parameters
    ----------
    path : Path
        The file, in UTF-8.

    Returns
    -------
    list of str
        The lines, without their ends.

    Raises
    ------
    ScanReadError
        If the file is not a text file.
    """
    no_text = f"not a text file, though its name ends in {path.suffix}"
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ScanReadError(no_text) from error
    if "\0" in text:
        raise ScanReadError(no_text)
    return text.splitlines()


def _table(path: Path, *, n_columns: int, skip: int = 0) -> NDArray[np.float64]:
    """The first columns of a table, separated by blanks, commas or semicolons, with ``#`` for comments."""
    lines = [line.replace(",", " ").replace(";", " ") for line in text_lines(path)[skip:]]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # an empty table is reported by the caller
            table = np.loadtxt(lines, dtype=np.float64, usecols=range(n_columns), ndmin=2)
    except ValueError as error:
        raise ScanReadError(f"each line must hold {n_columns} numbers: {error}") from error
    return table.reshape(-1, n_columns)
