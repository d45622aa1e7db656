"""Printed tables: columns of fixed width, and the measures of retrieval as text."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import astuple
from typing import NamedTuple

import click

from pcretrieve.evaluation import RetrievalMeasures

__all__ = ["MEASURES", "Column", "Table", "is_missing", "measure_values", "print_lines"]

# Titles of the measures, in the order of the first fields of `RetrievalMeasures`.
MEASURES = ("NN", "FT", "ST", "E", "DCG", "mAP")


class Column(NamedTuple):
    """One column of a table.

    Attributes
    ----------
    title : str
        Title of the column.
    width : int
        Number of characters.
    format : str, default ""
        Format specification of a number, such as ``.2f``; a string is printed as it is.
    align : {"<", ">"}, default ">"
        Alignment, left or right.
    """

    title: str
    width: int
    format: str = ""
    align: str = ">"


class Table:
    """Lines of columns that are separated by one space.

    Parameters
    ----------
    *columns : Column
        From left to right.
    """

    def __init__(self, *columns: Column) -> None:
        self.columns = columns

    @property
    def head(self) -> str:
        """The line of the titles."""
        return self._line(column.title for column in self.columns)

    def row(self, *values: object) -> str:
        """Format the values of one line.

        Parameters
        ----------
        *values : object
            One for each column; NaN and None are printed as ``-``.

        Returns
        -------
        str
            The line.

        Raises
        ------
        ValueError
            If there are more or fewer values than columns.
        """
        return self._line(
            self._cell(column, value) for column, value in zip(self.columns, values, strict=True)
        )

    @staticmethod
    def _cell(column: Column, value: object) -> str:
        if is_missing(value):
            return "-"
        return value if isinstance(value, str) else format(value, column.format)

    def _line(self, cells: Iterable[str]) -> str:
        padded = (
            f"{cell:{column.align}{column.width}}" for column, cell in zip(self.columns, cells, strict=True)
        )
        return " ".join(padded).rstrip()


def is_missing(value: object) -> bool:
    """Whether a value was not measured.

    Parameters
    ----------
    value : object
        Any value.

    Returns
    -------
    bool
        True for None and NaN.
    """
    return value is None or value != value


def measure_values(measures: RetrievalMeasures) -> tuple[float, ...]:
    """The values of the measures in `MEASURES`.

    Parameters
    ----------
    measures : RetrievalMeasures
        As from `pcretrieve.evaluation.folds.evaluate`.

    Returns
    -------
    tuple of float
        Between 0 and 1, in the order of `MEASURES`.
    """
    return tuple(astuple(measures)[: len(MEASURES)])


def print_lines(lines: Iterable[str]) -> None:
    """Print each line on standard output as soon as it is computed.

    Parameters
    ----------
    lines : iterable of str
        The lines; usually a generator, which may compute for minutes between two lines.
    """
    for line in lines:
        click.echo(line)
