"""The tables of a catalogue in a PostgreSQL database: their creation and migration."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from uuid import uuid4

from pcretrieve.catalogue.checksums import CHECKSUM_COLUMNS
from pcretrieve.catalogue.database import Database, Transaction
from pcretrieve.catalogue.defects import Defect
from pcretrieve.catalogue.opening import damaged
from pcretrieve.catalogue.record_rows import CHECKSUMS, NUMBERED, with_checksums
from pcretrieve.errors import CatalogueError

__all__ = ["SCHEMA_VERSION", "changed", "orphans", "prepare_tables", "read_settings"]

SCHEMA_VERSION = 5

# Statements that turn a version into the next one, by the earlier version.
MIGRATIONS: dict[int, tuple[str, ...]] = {
    3: (
        "ALTER TABLE shapes ADD COLUMN stamp text",
        *(f"ALTER TABLE shapes ADD COLUMN {name} bigint" for name in CHECKSUM_COLUMNS.values()),
    ),
    4: (),  # thumbnails are further payloads
}

# Number of rows that get their checksums together.
AT_ONCE = 1000

# The lock while there is no table to lock: a number that no other program is likely to use.
CREATION_LOCK = "SELECT pg_advisory_xact_lock(7205759403792794)"


def prepare_tables(database: Database, settings: Mapping[str, str], *, create: bool) -> None:
    """Check that a schema has a catalogue of the current version; create or migrate it, if necessary."""
    with database.reading() as reading:
        there = _is_there(database, reading)
        version = _version(database, reading) if there else None
    if not there and not create:
        raise CatalogueError(f"there is no catalogue {database.location}: make one with `pcretrieve ingest`")
    if version != SCHEMA_VERSION:
        with database.writing(CREATION_LOCK) as writing:
            # Another process may have created or migrated the tables in the meantime.
            if not _is_there(database, writing):
                _create(database, writing, settings)
            before = _version(database, writing)
            for earlier in range(before, SCHEMA_VERSION):
                for statement in MIGRATIONS[earlier]:
                    writing.run(statement)
            if before < 4:
                _add_checksums(writing)
            writing.run(
                "UPDATE meta SET value = :version WHERE key = 'schema_version'", version=str(SCHEMA_VERSION)
            )


def read_settings(transaction: Transaction) -> dict[str, str]:
    """The settings of a catalogue, and the names of its state."""
    return {key: value for key, value in transaction.all("SELECT key, value FROM meta")}


def changed(writing: Transaction, revision: str) -> None:
    """Give the new state a name that no earlier state had, not even before a copy was restored."""
    writing.run("UPDATE meta SET value = :name WHERE key = :key", name=uuid4().hex, key=revision)


def orphans(transaction: Transaction, *, repair: bool) -> list[Defect]:
    """Rows of no shape, which foreign keys prevent unless they were switched off, as by some restorations."""
    found = []
    for table in ("provenance", "signatures", "payloads"):
        condition = f"FROM {table} WHERE NOT EXISTS (SELECT 1 FROM shapes WHERE number = shape)"
        ((number,),) = transaction.all(f"SELECT count(*) {condition}")
        if number and repair:
            transaction.run(f"DELETE {condition}")
        if number:
            done = "removed" if repair else None
            found.append(Defect("orphan", None, f"{number} rows of {table} are of no shape", done))
    return found


def _is_there(database: Database, transaction: Transaction) -> bool:
    # Not by to_regclass, which may not see a schema that was created since this transaction began.
    query = (
        "SELECT 1 FROM pg_tables WHERE tablename = 'meta' AND schemaname = :schema "
        "AND has_schema_privilege(schemaname, 'USAGE')"
    )
    return bool(transaction.all(query, schema=database.schema))


def _version(database: Database, transaction: Transaction) -> int:
    version = read_settings(transaction).get("schema_version", "")
    if not version.isdecimal():
        raise damaged(database.location, "it has no version")
    if int(version) > SCHEMA_VERSION:
        raise CatalogueError(
            f"{database.location} was written by a newer pcretrieve (schema {version}, this one knows "
            f"{SCHEMA_VERSION}): upgrade pcretrieve"
        )
    return int(version)


def _add_checksums(writing: Transaction) -> None:
    """Store the checksums of rows of version 3, as they are now."""
    last = 0
    while rows := writing.all(NUMBERED, last=last, limit=AT_ONCE):
        writing.run_each(CHECKSUMS, [with_checksums(row) for row in rows])
        last = rows[-1][0]


def _create(database: Database, writing: Transaction, settings: Mapping[str, str]) -> None:
    if writing.all("SHOW server_encoding") != [("UTF8",)]:
        raise CatalogueError(f"{database.location} must be a database with the encoding UTF8: create another")
    # Not IF NOT EXISTS alone, which needs the privilege to create schemas if the schema exists too.
    if not writing.all("SELECT 1 FROM pg_namespace WHERE nspname = :schema", schema=database.schema):
        writing.run(f"CREATE SCHEMA {database.quoted_schema}")
    tables = resources.files(__package__).joinpath("postgresql.sql").read_text("utf-8")
    writing.run(tables)
    kept = {"revision": uuid4().hex, "label_revision": uuid4().hex, "schema_version": str(SCHEMA_VERSION)}
    rows = [{"key": key, "value": value} for key, value in {**settings, **kept}.items()]
    writing.run_each("INSERT INTO meta VALUES (:key, :value)", rows)
