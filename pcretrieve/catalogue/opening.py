"""Connections to SQLite files, and errors of SQLite → messages with advice."""

from __future__ import annotations

import os
import sqlite3
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pcretrieve.errors import CatalogueError

__all__ = ["connect", "damaged", "intact", "is_writable", "translated"]

# Longest time to wait for another process that is writing; seconds.
LOCK_TIMEOUT = 30.0


def connect(path: Path, *, create: bool) -> sqlite3.Connection:
    """Connect to a file.

    Parameters
    ----------
    path : Path
        The file.
    create : bool
        Whether the file is created if it does not exist.

    Returns
    -------
    sqlite3.Connection
        The connection; read-only, if the file cannot be written.

    Raises
    ------
    CatalogueError
        If the path is a folder, does not exist and `create` is false, or cannot be opened or created.
    """
    try:
        if path.is_dir():
            raise CatalogueError(f"{path} is a folder: name a file for --catalogue")
        exists = path.exists() and path.stat().st_size > 0
    except OSError as error:
        raise CatalogueError(f"cannot use the catalogue {path}: {error.strerror}") from error
    if not exists and not create:
        raise CatalogueError(f"there is no catalogue {path}: make one with `pcretrieve ingest`")
    if not path.parent.is_dir():
        raise CatalogueError(f"there is no folder {path.parent} to put a catalogue into: make it first")
    with translated(path):
        if not exists or is_writable(path):
            return _connected(path, "rwc" if create else "rw")
        if create:
            raise CatalogueError(f"{path} {ADVICE['readonly']}")
        try:
            return _connected(path, "ro")
        except sqlite3.OperationalError:
            # SQLite cannot create its further files in this folder, and needs none if no process writes.
            return _connected(path, "ro&immutable=1")


def is_writable(path: Path) -> bool:
    """Whether SQLite can write to a file, for which it creates further files in the same folder.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    bool
        True if the file and its folder can be written.
    """
    return os.access(path, os.W_OK) and os.access(path.parent, os.W_OK)


def damaged(location: str | Path, how: str) -> CatalogueError:
    """The error for a catalogue with invalid content.

    Parameters
    ----------
    location : str or Path
        The catalogue, as the message names it.
    how : str
        The defect of the content.

    Returns
    -------
    CatalogueError
        The error to be raised.
    """
    return CatalogueError(f"{location} is damaged ({how}): restore a copy, or ingest into a new catalogue")


@contextmanager
def intact(location: str | Path, what: str) -> Iterator[None]:
    """Convert errors due to invalid bytes to the error for a damaged catalogue.

    Parameters
    ----------
    location : str or Path
        The catalogue, as the message names it.
    what : str
        What is read, for the message.

    Yields
    ------
    None
        Once, for the code that reads.

    Raises
    ------
    CatalogueError
        If the code raises an error that invalid bytes cause.
    """
    try:
        yield
    except (KeyError, ValueError, struct.error, zlib.error) as error:
        raise damaged(location, f"{what} cannot be read: {error}") from error


def _connected(path: Path, mode: str) -> sqlite3.Connection:
    connection = sqlite3.connect(f"{path.absolute().as_uri()}?mode={mode}", uri=True, timeout=LOCK_TIMEOUT)
    try:
        connection.execute("PRAGMA synchronous = NORMAL")
        connection.execute("SELECT count(*) FROM sqlite_master")
    except sqlite3.Error:
        connection.close()
        raise
    return connection


@contextmanager
def translated(path: Path) -> Iterator[None]:
    """Convert errors of SQLite to errors with advice.

    Parameters
    ----------
    path : Path
        The file, as the message names it.

    Yields
    ------
    None
        Once, for the code that uses the file.

    Raises
    ------
    CatalogueError
        If the code raises an error of SQLite.
    """
    try:
        yield
    except sqlite3.Error as error:
        text = str(error)
        if "malformed" in text:
            raise damaged(path, text) from error
        advice = next((advice for words, advice in ADVICE.items() if words in text), None)
        message = f"{path} {advice}" if advice else f"cannot use the catalogue {path}: {text}"
        raise CatalogueError(message) from error


ADVICE = {
    "locked": "is locked by another process: wait until that has finished",
    "not a database": "is not a catalogue: give another --catalogue",
    "readonly": "cannot be written to: change its permissions, or give another --catalogue",
    "unable to open": "cannot be opened: see whether the file and its folder may be read and written",
    "disk is full": "cannot grow, the disk is full: make room and run the same command again",
}
