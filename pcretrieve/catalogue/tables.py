"""The tables of a catalogue, declared once, and their statements for SQLite and for PostgreSQL.

They are declared as plain data: SQLAlchemy Core takes .17 to .22 s to import (version 2.1; without what a
query imports anyway .16 s), which is 6 % of a query for a scan in a new process, and a quarter of one for a
stored id.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Literal
from uuid import uuid4

from pcretrieve.errors import CatalogueError

SCHEMA_VERSION = 7

#: The parts that are stored of a shape besides its record and its signatures; each can be read separately.
Payload = Literal["spectra", "moments", "overlaps", "thumbnails", "meshes"]
PAYLOADS: tuple[Payload, ...] = ("spectra", "moments", "overlaps", "thumbnails", "meshes")

# Columns by table. The table shapes has the small columns that are searched and listed; what is read of
# single shapes only is in further tables, by the number of the shape.
TABLES = {
    "meta": {
        # options (JSON), numbers_version, schema_version, revision
        "key": "{text} PRIMARY KEY",
        "value": "{text} NOT NULL",
    },
    "shapes": {
        "number": "integer PRIMARY KEY",
        "id": "{text} NOT NULL UNIQUE",
        "path": "{text} NOT NULL",
        "content_hash": "{text} NOT NULL",
        "label": "{text}",
        "status": "{text} NOT NULL",  # done or failed
        "stage": "{text}",  # where it failed
        "error": "{text}",  # the name of the exception
        "message": "{text}",
        "area": "double precision",  # of the first surface, unit length² of the shape
        "n_vertices": "bigint",  # of the first surface, as the next two
        "n_faces": "bigint",
        "euler": "bigint",
        "judgement": "{text}",  # sound, doubtful or unusable; NULL: not judged
        "uncertainty": "double precision",  # log-signature error that the checks let expect
        "metres_per_unit": "double precision",  # length of the unit of the area; NULL: unknown
        "stamp": "{text}",  # by which an unchanged file is known without reading it; NULL: unknown
        "checksum": "bigint NOT NULL",  # of the record, see pcretrieve.catalogue.records
    },
    "provenance": {
        "shape": "integer PRIMARY KEY",
        "steps": "{text} NOT NULL",  # JSON: stage, seconds, sizes, notes
        "options_digest": "{text} NOT NULL",
        "versions": "{text} NOT NULL",  # JSON
        "added": "{text} NOT NULL",  # UTC, ISO 8601
        "reasons": "{text}",  # JSON: of the judgement; NULL: not judged
    },
    # All digests of signatures, without which the signatures of one shape are not found by their key.
    "descriptors": {"digest": "{text} PRIMARY KEY"},
    "signatures": {
        "digest": "{text} NOT NULL",  # of the options; "own" for those of the catalogue
        "shape": "integer NOT NULL",
        "value": "{octets} NOT NULL",  # (L,) float64, little-endian, and a checksum
    },
    # Arrays of the s surfaces of a shape, as pcretrieve.catalogue.arrays packs them. The smallest are first,
    # because SQLite reads a row up to the column that is asked for.
    "arrays": {
        "shape": "integer PRIMARY KEY",
        "spectra": "{octets}",  # areas (s,), unit length² of the file; eigenvalues (s, k) of unit area
        "moments": "{octets}",  # (s, k, k) ⟨φ_i², φ_j⟩ of unit area
        "overlaps": "{octets}",  # (s, k, k) ⟨φ_i², φ_j²⟩ of unit area
        "thumbnails": "{octets}",  # bytes of a PNG file: a picture of the first surface
        "meshes": "{octets}",  # vertices and faces of each surface in turn, unit length of the file
    },
}

KEYS = {"signatures": ("digest", "shape")}

INDEXES = (
    "CREATE INDEX shapes_by_content ON shapes (content_hash)",
    "CREATE INDEX shapes_by_status ON shapes (status, id)",
    "CREATE INDEX doubtful_shapes ON shapes (id) WHERE judgement <> 'sound'",
)

# Number of rows that are read at a time.
READ_AT_ONCE = 1000


def created(
    settings: Mapping[str, str], words: Mapping[str, str], further: Iterable[str]
) -> Iterator[tuple[str, Sequence[object]]]:
    """Yield the statements that create all tables, and that store the settings, with their parameters.

    words: of the database: the types ``text`` and ``octets``, and ``ordered``, which stands after a table
        whose rows are in the order of its key.
    further: statements after those that create the tables.
    """
    for table, columns in TABLES.items():
        # In quotes, because "overlaps" is a word of PostgreSQL.
        lines = [f'"{name}" {kind}' for name, kind in columns.items()]
        lines += [f"PRIMARY KEY ({', '.join(KEYS[table])})"] if table in KEYS else []
        ordered = "{ordered}" if table in KEYS else ""
        yield f"CREATE TABLE {table} ({', '.join(lines)}){ordered}".format_map(words), ()
    for statement in (*INDEXES, *further):
        yield statement, ()
    names = {"schema_version": str(SCHEMA_VERSION), "revision": uuid4().hex}
    for setting in {**settings, **names}.items():
        yield inserting("meta"), setting


def inserting(table: str) -> str:
    """The statement that inserts a row, with a parameter for each column."""
    return f"INSERT INTO {table} VALUES ({', '.join('?' * len(TABLES[table]))})"


def check_version(location: str, settings: Mapping[str, str]) -> None:
    """Check that the tables of a catalogue are those of this version."""
    version = settings.get("schema_version", "0")
    if not settings or not version.isdecimal():
        raise damaged(location, "it has no version")
    if int(version) > SCHEMA_VERSION:
        raise CatalogueError(
            f"{location} was written by a newer pcretrieve (schema {version}, this one knows "
            f"{SCHEMA_VERSION}): upgrade pcretrieve"
        )
    if int(version) < SCHEMA_VERSION:
        raise CatalogueError(
            f"{location} was written by an older pcretrieve, whose tables this one does not know: ingest "
            "into a new catalogue, or use that version"
        )


def damaged(location: str, how: str) -> CatalogueError:
    """The error for a catalogue with invalid content."""
    return CatalogueError(f"{location} is damaged ({how}): restore a copy, or ingest into a new catalogue")


class ChangedRow(CatalogueError):
    """Texts or numbers of a row that are not those that were stored, as by a flipped bit on the disk."""


def changed_row(location: str, how: str) -> ChangedRow:
    """The error for a row that `pcretrieve check --repair` removes."""
    return ChangedRow(
        f"{location} is damaged ({how}): restore a copy, or repair it with `pcretrieve check --repair`"
    )
