"""Parts of statements on the tables of a catalogue in PostgreSQL."""

from __future__ import annotations

from collections.abc import Iterable

__all__ = ["any_of", "has_path", "inserting"]


def inserting(table: str, columns: Iterable[str]) -> str:
    """The statement that inserts a row, with a parameter for each column."""
    names = tuple(columns)
    marks = ", ".join(f":{name}" for name in names)
    return f"INSERT INTO {table} ({', '.join(names)}) VALUES ({marks})"


def any_of(column: str) -> str:
    """The condition that the value of a column is in the parameter ``values``."""
    return f"{column} = ANY(CAST(:values AS text[]))"


def has_path(parameter: str) -> str:
    """The condition that a shape has a path, in the words of the index of paths."""
    return f"md5(path) = md5(:{parameter}) AND path = :{parameter}"
