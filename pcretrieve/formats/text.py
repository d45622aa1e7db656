"""Points as lines of text: ``.xyz``, ``.xyzn``, ``.pts``."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import ScanReadError
from pcretrieve.formats.raw import RawScan, incomplete

__all__ = ["read_pts", "read_xyz", "read_xyzn", "text_lines"]


def read_xyz(path: Path) -> RawScan:
    """``x y z`` a line; further columns are ignored."""
    return RawScan(_table(path, n_columns=3))


def read_xyzn(path: Path) -> RawScan:
    """``x y z nx ny nz`` a line."""
    table = _table(path, n_columns=6)
    return RawScan(table[:, :3], normals=table[:, 3:])


def read_pts(path: Path) -> RawScan:
    """The number of points, then ``x y z …`` a line; a missing count is forgiven, a wrong one is not."""
    lines = text_lines(path)
    first = lines[0].split() if lines else []
    # As a float: a number of thousands of digits, which int refuses, is a wrong count like any other.
    promised = float(first[0]) if len(first) == 1 and first[0].isdecimal() else None
    points = _table(path, n_columns=3, skip=0 if promised is None else 1)
    if promised is not None and promised != len(points):
        raise incomplete(path, f"its first line promises {promised:.0f} points, it holds {len(points)}")
    return RawScan(points)


def text_lines(path: Path) -> list[str]:
    """The lines of a text file.

    Raises
    ------
    ScanReadError
        If it is none.
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
    """The first columns of a table of numbers, separated by blanks, commas or semicolons; ``#`` comments."""
    lines = [line.replace(",", " ").replace(";", " ") for line in text_lines(path)[skip:]]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # an empty table is reported further down
            table = np.loadtxt(lines, dtype=np.float64, usecols=range(n_columns), ndmin=2)
    except ValueError as error:
        raise ScanReadError(f"each line must hold {n_columns} numbers: {error}") from error
    return table.reshape(-1, n_columns)
