"""The tables of a catalogue file."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import resources

__all__ = ["NEW_NAME", "SCHEMA_VERSION", "create_tables", "table_names", "transaction"]

SCHEMA_VERSION = 2

# SQL for the name of a state of the catalogue. A counter would give two states one name, where a copy of an
# earlier state is restored and counts on from there.
NEW_NAME = "lower(hex(randomblob(16)))"


def create_tables(connection: sqlite3.Connection, settings: Mapping[str, str]) -> None:
    """Make all tables, within the transaction that is under way, and store the settings.

    Parameters
    ----------
    connection : sqlite3.Connection
        Of the file.
    settings : mapping of str to str
        ``options`` and ``numbers_version``.
    """
    schema = resources.files(__package__).joinpath("schema.sql").read_text("utf-8")
    # Not by executescript, which ends the transaction first.
    for statement in schema.split(";\n"):
        connection.execute(statement)
    connection.executemany("INSERT INTO meta VALUES (?, ?)", settings.items())
    connection.executemany(f"INSERT INTO meta VALUES (?, {NEW_NAME})", [("revision",), ("label_revision",)])
    connection.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")


def table_names(connection: sqlite3.Connection) -> set[str]:
    """The tables that a file has now.

    Parameters
    ----------
    connection : sqlite3.Connection
        Of the file.

    Returns
    -------
    set of str
        Their names.
    """
    return {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}


@contextmanager
def transaction(connection: sqlite3.Connection, kind: str) -> Iterator[None]:
    """One transaction, which is rolled back if the code in it raises an exception.

    Parameters
    ----------
    connection : sqlite3.Connection
        Of the file.
    kind : {"DEFERRED", "IMMEDIATE"}
        The first for readers, the second for writers.

    Yields
    ------
    None
        Once, for the code of the transaction.
    """
    connection.execute(f"BEGIN {kind}")
    with connection:
        yield
