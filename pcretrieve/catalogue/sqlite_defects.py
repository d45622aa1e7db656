"""Defects of an SQLite file: of its pages and SQL indexes, and rows of no shape."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence

from pcretrieve.catalogue.defects import Defect
from pcretrieve.catalogue.record_rows import PROVENANCE_COLUMNS, SHAPE_COLUMNS
from pcretrieve.catalogue.rows import PAYLOADS
from pcretrieve.catalogue.schema import transaction

__all__ = ["file_defects"]

# Largest number of defects of pages that are listed.
LISTED = 20

# Rows that belong to a shape, by table.
OF_NO_SHAPE = {name: "shape NOT IN (SELECT number FROM shapes)" for name in ("provenance", *PAYLOADS)} | {
    "signatures": "shape NOT IN (SELECT number FROM shapes) "
    "OR descriptor NOT IN (SELECT number FROM descriptors)"
}

# Columns, some of them of texts, by table, with the key of the table.
TEXTS = {
    "shapes": ("number", SHAPE_COLUMNS),
    "provenance": ("shape", PROVENANCE_COLUMNS),
}


def file_defects(connection: sqlite3.Connection, *, repair: bool) -> list[Defect]:
    """Defects of a file."""
    # A value that no status may have is a defect of one row, which its checksum shows.
    connection.execute("PRAGMA ignore_check_constraints = ON")
    try:
        return _file_defects(connection, repair=repair)
    finally:
        connection.execute("PRAGMA ignore_check_constraints = OFF")


def _file_defects(connection: sqlite3.Connection, *, repair: bool) -> list[Defect]:
    # Outside of a transaction, because one that has met a damaged page cannot be ended without an error.
    faults = _faults(connection)
    again = "SQL indexes made again" if faults and repair and _is_reindexed(connection) else None
    found = [Defect("database", None, fault, again) for fault in faults]
    if faults and not again:
        return found  # such a file is not changed, and not all of its rows can be read
    with transaction(connection, "IMMEDIATE" if repair else "DEFERRED"):
        for table, condition in OF_NO_SHAPE.items():
            ((number,),) = connection.execute(f"SELECT count(*) FROM {table} WHERE {condition}")
            if number and repair:
                connection.execute(f"DELETE FROM {table} WHERE {condition}")
            if number:
                done = "removed" if repair else None
                found.append(Defect("orphan", None, f"{number} rows of {table} are of no shape", done))
        for table, (key, columns) in TEXTS.items():
            for number, column, text in list(_unreadable(connection, table, key, columns)):
                if repair:
                    connection.execute(f"UPDATE {table} SET {column} = ? WHERE {key} = ?", (text, number))
                done = "bytes escaped" if repair else None
                found.append(Defect("database", None, f"the {column} {text!r} is not UTF-8 text", done))
    return found


def _unreadable(
    connection: sqlite3.Connection, table: str, key: str, columns: Sequence[str]
) -> Iterator[tuple[int, str, str]]:
    """Yield texts that cannot be read: the number of the shape, the column, the text with escaped bytes."""
    connection.text_factory = bytes
    try:
        for number, *values in connection.execute(f"SELECT {key}, {', '.join(columns)} FROM {table}"):
            for column, value in zip(columns, values, strict=True):
                text = value.decode("utf-8", "backslashreplace") if isinstance(value, bytes) else ""
                if text and text.encode() != value:
                    yield number, column, text
    finally:
        connection.text_factory = str


def _faults(connection: sqlite3.Connection) -> list[str]:
    try:
        rows = connection.execute(f"PRAGMA integrity_check({LISTED})").fetchall()
    except sqlite3.DatabaseError as error:
        return [str(error)]
    lines = [line for (text,) in rows for line in text.splitlines() if not line.startswith("***")]
    return [] if lines == ["ok"] else lines


class _Unrepaired(sqlite3.DatabaseError):
    """New SQL indexes have not repaired a file."""


def _is_reindexed(connection: sqlite3.Connection) -> bool:
    """Make the SQL indexes again; whether the file has no defect then. Otherwise it stays as it was."""
    try:
        with transaction(connection, "IMMEDIATE"):
            connection.execute("REINDEX")
            if _faults(connection):
                raise _Unrepaired
    except sqlite3.DatabaseError:
        return False
    return True
