"""Migration of files of earlier schema versions to the current version, in one transaction."""

from __future__ import annotations

import hashlib
import io
import json
import logging
import sqlite3
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from pcretrieve.catalogue.arrays import packed, packed_symmetric, packed_values
from pcretrieve.catalogue.checksums import CHECKSUM_COLUMNS
from pcretrieve.catalogue.filesystems import journal_of, mount_of
from pcretrieve.catalogue.opening import damaged, is_writable
from pcretrieve.catalogue.record_rows import CHECKSUMS, NUMBERED, with_checksums
from pcretrieve.catalogue.schema import SCHEMA_VERSION, create_tables, table_names, transaction
from pcretrieve.catalogue.settings import stored_options
from pcretrieve.errors import CatalogueError
from pcretrieve.options import NUMBERS_VERSION
from pcretrieve.values import ModalSpectrum

__all__ = ["prepare"]

logger = logging.getLogger(__name__)

Arrays = dict[str, NDArray[Any]]

# Tables that every version has.
TABLES = {"meta", "shapes"}

# Columns of the table `shapes` of version 1 that the present table has too.
COLUMNS_OF_1 = (
    "id, path, content_hash, label, status, stage, error, message, area, n_vertices, n_faces, euler"
)

# Number of shapes after which progress is logged.
REPORTED = 100

# Number of rows that get their checksums together.
ROWS_AT_ONCE = 1000


def prepare(connection: sqlite3.Connection, path: Path, settings: Mapping[str, str]) -> None:
    """Check that a file has the current schema; create the tables, or migrate it, if necessary."""
    tables = table_names(connection)
    if not tables:
        # With a write-ahead log, other processes can read while one process writes.
        connection.execute(f"PRAGMA journal_mode = {journal_of(mount_of(path)) or 'DELETE'}")
        with transaction(connection, "IMMEDIATE"):
            if not table_names(connection):  # another process may have created them in the meantime
                create_tables(connection, settings)
        tables = table_names(connection)
    if not tables >= TABLES:
        raise CatalogueError(f"{path} is an SQLite file, but no catalogue: give another --catalogue")
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    if version > SCHEMA_VERSION:
        raise CatalogueError(
            f"{path} was written by a newer pcretrieve (schema {version}, this one knows {SCHEMA_VERSION}): "
            "upgrade pcretrieve"
        )
    if version < SCHEMA_VERSION:
        if not is_writable(path):
            raise CatalogueError(
                f"{path} was written by an older pcretrieve (schema {version}) and must be rewritten for "
                "this one, but cannot be written to: change its permissions, or open a copy"
            )
        _migrate(connection, path)


def _migrate(connection: sqlite3.Connection, path: Path) -> None:
    """Rewrite a file of version 1, or add to a later one what it lacks, in one transaction."""
    with transaction(connection, "IMMEDIATE"):
        (version,) = connection.execute("PRAGMA user_version").fetchone()
        if version == SCHEMA_VERSION:
            return  # another process has migrated the file in the meantime
        if version > 1:
            _add_columns(connection, version)
            _add_checksums(connection)
            return
        settings = _settings_of_1(path, dict(connection.execute("SELECT key, value FROM meta")))
        stored_options(path, settings)  # raises, before the file is changed, if it could not be used
        (total,) = connection.execute("SELECT count(*) FROM shapes").fetchone()
        logger.warning(
            "rewriting %s, %d shapes, for this version of pcretrieve; this happens once", path, total
        )
        connection.execute("DROP INDEX shapes_by_content")
        connection.execute("DROP TABLE whitenings")
        connection.execute("DROP TABLE meta")
        connection.execute("ALTER TABLE shapes RENAME TO shapes_1")
        create_tables(connection, settings)
        connection.execute("INSERT INTO descriptors VALUES (0, 'own')")
        ids = [shape_id for (shape_id,) in connection.execute("SELECT id FROM shapes_1 ORDER BY id")]
        for done, shape_id in enumerate(ids, start=1):
            _move_shape_of_1(connection, path, shape_id)
            if done % REPORTED == 0:
                logger.info("rewritten: %d of %d shapes", done, total)
        connection.execute("DROP TABLE shapes_1")
        _add_checksums(connection)


def _add_columns(connection: sqlite3.Connection, version: int) -> None:
    """Add the columns and the table of later versions, which are empty: none of this was known before."""
    for since, table, column in (
        (3, "shapes", "judgement TEXT"),
        (3, "shapes", "uncertainty REAL"),
        (3, "shapes", "metres_per_unit REAL"),
        (3, "provenance", "reasons TEXT"),
        (4, "shapes", "stamp TEXT"),
        *((4, "shapes", f"{name} INTEGER") for name in CHECKSUM_COLUMNS.values()),
    ):
        if version < since:
            connection.execute(f"ALTER TABLE {table} ADD COLUMN {column}")
    # Thumbnails of earlier shapes are drawn when they are needed.
    connection.execute("CREATE TABLE thumbnails (shape INTEGER PRIMARY KEY, arrays BLOB NOT NULL)")
    if version < 3:
        connection.execute("CREATE INDEX doubtful_shapes ON shapes (id) WHERE judgement <> 'sound'")
    connection.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")


def _add_checksums(connection: sqlite3.Connection) -> None:
    """Store the checksums of all rows as they are now."""
    last = 0
    # A text that is damaged already can be migrated too, and is found by the next check.
    connection.text_factory = lambda text: text.decode("utf-8", "replace")
    try:
        while rows := connection.execute(NUMBERED, {"last": last, "limit": ROWS_AT_ONCE}).fetchall():
            connection.executemany(CHECKSUMS, [with_checksums(row) for row in rows])
            last = rows[-1][0]
    finally:
        connection.text_factory = str


def _settings_of_1(path: Path, meta: Mapping[str, str]) -> dict[str, str]:
    """The settings of version 2 and later. Version 1 had one digest of options and version of numbers."""
    try:
        options, digest = json.loads(meta["options"]), meta["digest"]
        numbers = {name: value for name, value in options.items() if name not in ("signature", "retrieval")}
        # Before there were options of retrieval, the scale "area" had the present meaning of "auto".
        if "retrieval" not in options and options["signature"].get("scale") == "area":
            options["signature"]["scale"] = "auto"
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise damaged(path, "it has no readable options") from error
    for version in range(NUMBERS_VERSION, 0, -1):
        made_by = json.dumps(numbers | {"numbers_version": version}, sort_keys=True)
        if hashlib.sha256(made_by.encode()).hexdigest()[:16] == digest:
            return {"options": json.dumps(options), "numbers_version": str(version)}
    raise CatalogueError(
        f"{path} was built by a pcretrieve whose numbers differ: ingest into a new catalogue"
    )


def _move_shape_of_1(connection: sqlite3.Connection, path: Path, shape_id: str) -> None:
    """Move a shape from the table of version 1 to the new tables, so that its pages can be used again."""
    chosen = (shape_id,)
    number = connection.execute(
        f"INSERT INTO shapes ({COLUMNS_OF_1}) SELECT {COLUMNS_OF_1} FROM shapes_1 WHERE id = ?",
        chosen,
    ).lastrowid
    connection.execute(
        "INSERT INTO provenance SELECT ?, steps, options_digest, versions, added, NULL FROM shapes_1 "
        "WHERE id = ?",
        (number, shape_id),
    )
    status, area, *archives = connection.execute(
        "SELECT status, area, signature, eigenvalues, moments, mesh FROM shapes_1 WHERE id = ?", chosen
    ).fetchone()
    connection.execute("DELETE FROM shapes_1 WHERE id = ?", chosen)
    if status != "done":
        return
    try:
        arrays = [_archive(archive) for archive in archives]
        packages = _packages_of_1(area, *arrays)
    except (KeyError, ValueError, TypeError, EOFError, OSError, BadZipFile, zlib.error) as error:
        raise damaged(path, f"the arrays of {shape_id!r} cannot be read: {error}") from error
    connection.execute("INSERT INTO signatures VALUES (0, ?, ?)", (number, packages.pop("signatures")))
    for name, package in packages.items():
        connection.execute(f"INSERT INTO {name} VALUES (?, ?)", (number, package))


def _archive(blob: bytes) -> Arrays:
    with np.load(io.BytesIO(blob), allow_pickle=False) as archive:
        return dict(archive)


def _packages_of_1(
    area: float, signature: Arrays, eigenvalues: Arrays, moments: Arrays, mesh: Arrays
) -> dict[str, bytes]:
    """The arrays of version 1 as later versions store them, by table."""
    # In version 1 all surfaces of a scan were scaled by the factor that gave the first surface unit area.
    stored = zip(
        eigenvalues["values"], moments["values"], eigenvalues["areas"], moments["overlaps"], strict=True
    )
    spectra = [ModalSpectrum(*parts).scaled(1.0) for parts in stored]
    return {
        "signatures": packed_values(signature["values"]),
        "spectra": packed([area * eigenvalues["areas"], np.stack([s.eigenvalues for s in spectra])]),
        "moments": packed([np.stack([s.moments for s in spectra])]),
        "overlaps": packed_symmetric(np.stack([s.known_overlaps() for s in spectra])),
        "meshes": packed([mesh["vertices"], mesh["faces"]]),
    }
