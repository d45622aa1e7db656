"""Text files: their lines, and tables of numbers."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import ScanReadError

__all__ = ["number_table", "text_lines"]


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


def number_table(lines: Sequence[str], *, n_columns: int) -> NDArray[np.float64]:
    """The first columns of a table of numbers.

    Parameters
    ----------
    lines : sequence of str
        The rows. Numbers are separated by blanks, commas or semicolons; ``#`` begins a comment.
    n_columns : int
        Number of columns; further columns are ignored.

    Returns
    -------
    (n, n_columns) float64
        The numbers.

    Raises
    ------
    ScanReadError
        If a line has too few numbers, or holds something else.
    """
    lines = [line.replace(",", " ").replace(";", " ") for line in lines]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # an empty table is reported by the caller
            table = np.loadtxt(lines, dtype=np.float64, usecols=range(n_columns), ndmin=2)
    except ValueError as error:
        raise ScanReadError(f"each line must hold {n_columns} numbers: {error}") from error
    return table.reshape(-1, n_columns)
