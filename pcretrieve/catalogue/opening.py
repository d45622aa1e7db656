"""Connections to SQLite files, and errors of SQLite → messages with advice."""

from __future__ import annotations

import logging
import os
import sqlite3
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pcretrieve.catalogue.filesystems import journal_of, mount_of
from pcretrieve.errors import CatalogueError

__all__ = ["connect", "damaged", "intact", "is_writable", "shrink", "translated"]

logger = logging.getLogger(__name__)

# Longest time to wait for another process that is writing; seconds.
LOCK_TIMEOUT = 30.0

# Share of unused pages of a file above which it is written again without them.
UNUSED = 0.25


def connect(path: Path, *, create: bool) -> sqlite3.Connection:
    """Connect to a file."""
    try:
        if path.is_dir():
            raise CatalogueError(f"{path} is a folder: name a file for --catalogue")
        size = path.stat().st_size if path.exists() else 0
    except OSError as error:
        raise CatalogueError(f"cannot use the catalogue {path}: {error.strerror}") from error
    if size == 1:  # which SQLite takes for an empty file
        raise CatalogueError(f"{path} {ADVICE['not a database']}")
    if not size and not create:
        raise CatalogueError(f"there is no catalogue {path}: make one with `pcretrieve ingest`")
    if not path.parent.is_dir():
        raise CatalogueError(f"there is no folder {path.parent} to put a catalogue into: make it first")
    mount = mount_of(path)
    if create and journal_of(mount) is None:
        raise CatalogueError(
            f"{path} is on a file system of the type {mount.kind}, whose locks other computers do not see, "
            "so that two writers would damage it: ingest into a file on a local disk, and copy it when it is "
            "complete (pcretrieve backup); or use PostgreSQL"
        )
    with translated(path):
        if not size or is_writable(path):
            return _connected(path, "rwc" if create else "rw")
        if create:
            raise CatalogueError(f"{path} {ADVICE['readonly']}")
        try:
            return _connected(path, "ro")
        except sqlite3.OperationalError as error:
            log = path.with_name(f"{path.name}-wal")
            if log.exists() and log.stat().st_size:
                raise CatalogueError(
                    f"{path} is incomplete without its last changes in {log.name}, which cannot be applied "
                    "in a folder that cannot be written to: copy both files elsewhere, and use the copies"
                ) from error
            # SQLite cannot create its further files in this folder, and needs none if no process writes.
            return _connected(path, "ro&immutable=1")


def is_writable(path: Path) -> bool:
    """Whether SQLite can write to a file, for which it creates further files in the same folder."""
    if journal_of(mount_of(path)) is None:
        return False
    effective = os.access in os.supports_effective_ids  # the user by whose rights files are opened
    return all(os.access(place, os.W_OK, effective_ids=effective) for place in (path, path.parent))


def shrink(connection: sqlite3.Connection, path: Path) -> None:
    """Give the space of removed rows back to the disk, if that is much of the file."""
    try:
        (unused,) = connection.execute("PRAGMA freelist_count").fetchone()
        (pages,) = connection.execute("PRAGMA page_count").fetchone()
        if unused > UNUSED * pages:
            connection.execute("VACUUM")
    # Another process writes the file, or the disk is full: the rows are removed all the same.
    except sqlite3.Error as error:
        logger.info("the unused space of %s stays in it: %s", path, error)


def damaged(location: str | Path, how: str) -> CatalogueError:
    """The error for a catalogue with invalid content."""
    return CatalogueError(f"{location} is damaged ({how}): restore a copy, or ingest into a new catalogue")


@contextmanager
def intact(location: str | Path, what: str) -> Iterator[None]:
    """Convert errors due to invalid bytes to the error for a damaged catalogue."""
    try:
        yield
    except (KeyError, ValueError, struct.error, zlib.error) as error:
        raise damaged(location, f"{what} cannot be read: {error}") from error


def _connected(path: Path, mode: str) -> sqlite3.Connection:
    connection = sqlite3.connect(f"{path.absolute().as_uri()}?mode={mode}", uri=True, timeout=LOCK_TIMEOUT)
    try:
        if mode.startswith("rw") and journal_of(mount_of(path)) == "DELETE":
            _use_rollback_journal(connection)
        else:
            connection.execute("PRAGMA synchronous = NORMAL")
        connection.execute("SELECT count(*) FROM sqlite_master")
    except (sqlite3.Error, UnicodeDecodeError):
        connection.close()
        raise
    return connection


def _use_rollback_journal(connection: sqlite3.Connection) -> None:
    """Use a rollback journal, also for a file that was copied from a place where it had a write-ahead log."""
    # A rollback journal is safe if the computer fails only if it is on the disk before the file is written.
    connection.execute("PRAGMA synchronous = FULL")
    # With an exclusive lock, SQLite reads a log without memory that is shared with other processes. Python
    # does not look for the log in the header: closing the file would release all locks of this process.
    connection.execute("PRAGMA locking_mode = EXCLUSIVE")
    connection.execute("PRAGMA journal_mode = DELETE")
    connection.execute("PRAGMA locking_mode = NORMAL")


@contextmanager
def translated(path: Path) -> Iterator[None]:
    """Convert errors of SQLite to errors with advice."""
    try:
        yield
    except sqlite3.Error as error:
        text = str(error)
        if "malformed" in text:
            raise damaged(path, text) from error
        advice = next((advice for words, advice in ADVICE.items() if words in text), None)
        message = f"{path} {advice}" if advice else f"cannot use the catalogue {path}: {text}"
        raise CatalogueError(message) from error
    # Of a message of SQLite that quotes names which are damaged themselves.
    except UnicodeDecodeError as error:
        raise damaged(path, "a name in it is not UTF-8 text") from error


ADVICE = {
    "locked": "is locked by another process: wait until that has finished",
    "not a database": "is not a catalogue: give another --catalogue",
    "readonly": "cannot be written to: change its permissions, or give another --catalogue",
    "unable to open": "cannot be opened: see whether the file and its folder may be read and written",
    "disk I/O error": "cannot be read or written, the disk or the network reports an error: see to that, and "
    "run the same command again",
    "locking protocol": "cannot be locked, the file system does not allow it: name a file on a local disk",
    "disk is full": "cannot grow, the disk is full: make room and run the same command again",
}
