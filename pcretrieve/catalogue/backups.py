"""A catalogue → a copy of it in one SQLite file, while others write the catalogue."""

from __future__ import annotations

import logging
import os
import sqlite3
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory

from pcretrieve.catalogue.merging import merge_rows
from pcretrieve.catalogue.opening import connect, translated
from pcretrieve.catalogue.schema import table_names
from pcretrieve.catalogue.sqlite import SqliteRows
from pcretrieve.catalogue.stores import file_of, open_rows
from pcretrieve.errors import CatalogueError

__all__ = ["write_backup"]

logger = logging.getLogger(__name__)

# Number of pages, of 4 kB, that are copied between two lines of the log.
PAGES_AT_ONCE = 1 << 18


def write_backup(location: str | Path, target: Path) -> int:
    """Write a copy of a catalogue to one SQLite file.

    Returns int: the size of the file; bytes.
    """
    if target.exists():
        raise CatalogueError(f"{target} exists: name a new file for the backup, or remove it first")
    source = file_of(location)
    try:
        with TemporaryDirectory(prefix=".backup-", dir=target.parent) as folder:
            unfinished = Path(folder) / target.name
            if source is not None:
                _copy_file(source, unfinished)
            else:
                _copy_rows(str(location), unfinished)
            with unfinished.open("rb") as file:
                os.fsync(file.fileno())
            unfinished.rename(target)
        return target.stat().st_size
    except OSError as error:
        raise CatalogueError(
            f"cannot write the backup {target}: {error.strerror or error}; name a file in a folder that "
            "exists and can be written"
        ) from error


def _copy_file(source: Path, target: Path) -> None:
    """Copy an SQLite file of any schema version, with the changes of its log, in one state."""
    with closing(connect(source, create=False)) as connection:
        with translated(source):
            if not table_names(connection) >= {"meta", "shapes"}:
                raise CatalogueError(f"{source} is an SQLite file, but no catalogue: name another")
        with translated(target), closing(sqlite3.connect(target)) as copy:
            # Within a transaction, so that parts that are copied later belong to the same state.
            connection.execute("BEGIN")
            connection.execute("SELECT count(*) FROM meta")
            connection.backup(copy, pages=PAGES_AT_ONCE, progress=_log)
            connection.rollback()


def _log(status: int, n_left: int, n_pages: int) -> None:
    logger.info("copied: %d of %d pages", n_pages - n_left, n_pages)


def _copy_rows(location: str, target: Path) -> None:
    """Copy the shapes of a store that is no file."""
    with closing(open_rows(location, {}, create=False)) as rows:
        stored = rows.settings()
        settings = {name: stored[name] for name in ("options", "numbers_version")}
        with closing(SqliteRows(target, settings, create=True)) as copy:
            merge_rows(copy, [rows])
