"""The tables of a catalogue file."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import resources

__all__ = ["NEW_NAME", "SCHEMA_VERSION", "create_tables", "table_names", "transaction"]

SCHEMA_VERSION = 5

# SQL for the name of a state of the catalogue. It is random, because a counter would give two states the same
# name if a copy of an earlier state is restored and then changed.
NEW_NAME = "lower(hex(randomblob(16)))"


def create_tables(connection: sqlite3.Connection, settings: Mapping[str, str]) -> None:
    """Create all tables and store the settings, in the transaction that has begun."""
    schema = resources.files(__package__).joinpath("schema.sql").read_text("utf-8")
    # Not by executescript, which would commit the transaction.
    for statement in schema.split(";\n"):
        connection.execute(statement)
    connection.executemany("INSERT INTO meta VALUES (?, ?)", settings.items())
    connection.executemany(f"INSERT INTO meta VALUES (?, {NEW_NAME})", [("revision",), ("label_revision",)])
    connection.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")


def table_names(connection: sqlite3.Connection) -> set[str]:
    """The tables of a file."""
    return {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}


@contextmanager
def transaction(connection: sqlite3.Connection, kind: str) -> Iterator[None]:
    """One transaction, which is rolled back if the code in it raises an exception."""
    connection.execute(f"BEGIN {kind}")
    with connection:
        yield
