"""Files of earlier versions → files of this one, whole or not at all."""

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
from pcretrieve.catalogue.opening import damaged, is_writable
from pcretrieve.catalogue.schema import SCHEMA_VERSION, create_tables, table_names, transaction
from pcretrieve.catalogue.settings import stored_options
from pcretrieve.errors import CatalogueError
from pcretrieve.options import NUMBERS_VERSION
from pcretrieve.types import ModalSpectrum

__all__ = ["prepare"]

logger = logging.getLogger(__name__)

Arrays = dict[str, NDArray[Any]]

# Tables that every version has.
TABLES = {"meta", "shapes"}

# Shapes after which progress is logged.
REPORTED = 100


def prepare(connection: sqlite3.Connection, path: Path, settings: Mapping[str, str]) -> None:
    """See that a file is a catalogue of this schema; make it one where it is empty, or of an older schema.

    Parameters
    ----------
    connection : sqlite3.Connection
        Of the file.
    path : Path
        The file.
    settings : mapping of str to str
        For a catalogue that is made now: ``options`` and ``numbers_version``.

    Raises
    ------
    CatalogueError
        If it is no catalogue, was written by a newer pcretrieve, or was written by an older one and cannot be
        written now.
    """
    tables = table_names(connection)
    if not tables:
        # Readers go on while somebody writes.
        connection.execute("PRAGMA journal_mode = WAL")
        with transaction(connection, "IMMEDIATE"):
            if not table_names(connection):  # and nobody else has made them a moment ago
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
    """Rewrite a file of version 1, in one transaction."""
    with transaction(connection, "IMMEDIATE"):
        (version,) = connection.execute("PRAGMA user_version").fetchone()
        if version == SCHEMA_VERSION:
            return  # another process was faster
        settings = _settings_of_1(path, dict(connection.execute("SELECT key, value FROM meta")))
        stored_options(path, settings)  # what cannot be used afterwards is better left as it is
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


def _settings_of_1(path: Path, meta: Mapping[str, str]) -> dict[str, str]:
    """Settings as version 2 has them. Version 1 had a digest of options and of the version of numbers."""
    try:
        options, digest = json.loads(meta["options"]), meta["digest"]
        numbers = {name: value for name, value in options.items() if name not in ("signature", "retrieval")}
        # Before there were options of retrieval, the scale "area" was what "auto" is today.
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
    """Take a shape out of the table of version 1, so that its pages serve the next one, and put it in."""
    chosen = (shape_id,)
    number = connection.execute(
        "INSERT INTO shapes SELECT NULL, id, path, content_hash, label, status, stage, error, message, area, "
        "n_vertices, n_faces, euler FROM shapes_1 WHERE id = ?",
        chosen,
    ).lastrowid
    connection.execute(
        "INSERT INTO provenance SELECT ?, steps, options_digest, versions, added FROM shapes_1 WHERE id = ?",
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
    """What version 2 stores of the arrays of version 1, by table."""
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
