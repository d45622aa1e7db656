"""Path → an open catalogue file that can be trusted: ours, of this version, built with these options."""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from typing import Any

from pcretrieve.errors import CatalogueError, OptionError
from pcretrieve.options import PipelineOptions, options_difference

__all__ = ["connect", "damaged", "is_writable", "open_options", "translated"]

SCHEMA_VERSION = 1

TABLES = {"meta", "shapes", "whitenings"}

# How long to wait for another process that is writing; seconds.
LOCK_TIMEOUT = 30.0


def connect(path: Path, *, create: bool) -> sqlite3.Connection:
    """A connection to a file that exists, or may be made.

    Raises
    ------
    CatalogueError
        If it is a folder, is missing and `create` is false, or cannot be opened or made.
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
            # SQLite cannot make its files beside this one; where nobody is writing, it needs none.
            return _connected(path, "ro&immutable=1")


def is_writable(path: Path) -> bool:
    """Whether SQLite can write: it makes files beside its own."""
    return os.access(path, os.W_OK) and os.access(path.parent, os.W_OK)


def damaged(path: Path, how: str) -> CatalogueError:
    """The error for a catalogue whose content makes no sense."""
    return CatalogueError(f"{path} is damaged ({how}): restore a copy, or ingest into a new catalogue")


def _connected(path: Path, mode: str) -> sqlite3.Connection:
    connection = sqlite3.connect(f"{path.absolute().as_uri()}?mode={mode}", uri=True, timeout=LOCK_TIMEOUT)
    try:
        connection.execute("PRAGMA synchronous = NORMAL")
        connection.execute("SELECT count(*) FROM sqlite_master")
    except sqlite3.Error:
        connection.close()
        raise
    return connection


def open_options(
    connection: sqlite3.Connection, path: Path, options: PipelineOptions | None
) -> PipelineOptions:
    """The options that a catalogue was built with; a new one is given its tables, and `options`.

    Raises
    ------
    CatalogueError
        If it is no catalogue, was written by a newer pcretrieve, or was built with other options.
    """
    tables = _tables(connection)
    if not tables:
        _create(connection, options or PipelineOptions())
        tables = _tables(connection)
    if not tables >= TABLES:
        raise CatalogueError(f"{path} is an SQLite file, but no catalogue: give another --catalogue")
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    if version > SCHEMA_VERSION:
        raise CatalogueError(
            f"{path} was written by a newer pcretrieve (schema {version}, this one knows {SCHEMA_VERSION}): "
            "upgrade pcretrieve"
        )
    stored = dict(connection.execute("SELECT key, value FROM meta"))
    try:
        own = PipelineOptions(**_as_today(json.loads(stored["options"])))
        digest = stored["digest"]
    except (KeyError, TypeError, AttributeError, json.JSONDecodeError) as error:
        raise damaged(path, "it has no readable options") from error
    except OptionError as error:
        raise CatalogueError(
            f"{path} was built by a pcretrieve with other options ({error.message}): ingest into a new "
            "catalogue, or use that version"
        ) from error
    if own.digest != digest:
        raise CatalogueError(
            f"{path} was built by a pcretrieve whose numbers differ (digest {digest} there, {own.digest} "
            "here): ingest into a new catalogue"
        )
    if options is not None and options.signature_digest != own.signature_digest:
        difference = "; ".join(options_difference(own, options))
        raise CatalogueError(
            f"{path} was built with other options: {difference}. Ingest into a new catalogue, or "
            "leave the options out to use its own"
        )
    return own


def _as_today(stored: dict[str, Any]) -> dict[str, Any]:
    """Options as they are called today, from those that a catalogue was built with."""
    signature = stored.get("signature", {})
    # Before there were options of retrieval, a catalogue's scale "area" was what "auto" is today.
    if "retrieval" not in stored and signature.get("scale") == "area":
        return stored | {"signature": signature | {"scale": "auto"}}
    return stored


@contextmanager
def translated(path: Path) -> Iterator[None]:
    """SQLite's errors as `CatalogueError`, with what to do about them."""
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


def _tables(connection: sqlite3.Connection) -> set[str]:
    return {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}


def _create(connection: sqlite3.Connection, options: PipelineOptions) -> None:
    """All tables or none; where several processes try, the first one's options hold."""
    # Readers go on while someone writes.
    connection.execute("PRAGMA journal_mode = WAL")
    schema = resources.files(__package__).joinpath("schema.sql").read_text("utf-8")
    with connection:
        connection.executescript(f"BEGIN IMMEDIATE;\n{schema}\nPRAGMA user_version = {SCHEMA_VERSION};")
        connection.execute(
            "INSERT OR IGNORE INTO meta VALUES ('options', ?), ('digest', ?)",
            (options.model_dump_json(), options.digest),
        )
