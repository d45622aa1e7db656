"""The tables of a catalogue, the record of a shape with its rows, and the options of a catalogue.

The tables are plain data: SQLAlchemy takes .16 s to import, a quarter of a query for a stored id.
"""

from __future__ import annotations

import json
import zlib
from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields
from functools import wraps
from pathlib import Path
from typing import Any, Literal, ParamSpec, TypeVar
from uuid import uuid4

from pcretrieve.errors import CatalogueError, InputError, OptionError
from pcretrieve.options import NUMBERS_VERSION, PipelineOptions, options_difference
from pcretrieve.values import UNIT, FloatArray, Grade, Shape, Step

SCHEMA_VERSION = 1

#: The parts that are stored of a shape besides its record and its signatures; each can be read separately.
Payload = Literal["spectra", "moments", "overlaps", "up", "thumbnails", "meshes"]
PAYLOADS: tuple[Payload, ...] = (
    "spectra",
    "moments",
    "overlaps",
    "up",
    "thumbnails",
    "meshes",
)

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
        "grade": "{text}",  # good, poor or incomplete; NULL: not known
        "expected_error": "double precision",  # log-signature error that the checks let expect
        "metres_per_unit": "double precision",  # length of the unit of the area; NULL: unknown
        "stamp": "{text}",  # by which an unchanged file is known without reading it; NULL: unknown
        "checksum": "bigint NOT NULL",  # of the record: `checksum`
        "mark": "{text}",  # what a person decided: rescan, accept or note; NULL: nothing
        "note": "{text}",  # in the words of that person
    },
    "provenance": {
        "shape": "integer PRIMARY KEY",
        "steps": "{text} NOT NULL",  # JSON: stage, seconds, sizes, notes
        "options_digest": "{text} NOT NULL",
        "versions": "{text} NOT NULL",  # JSON
        "added": "{text} NOT NULL",  # UTC, ISO 8601
        "reasons": "{text}",  # JSON: of the grade; NULL: not known
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
        "up": "{octets}",  # (3,) the direction upwards in the picture, in the frame of the file
        "thumbnails": "{octets}",  # bytes of a PNG file: a picture of the first surface
        "meshes": "{octets}",  # vertices and faces of each surface in turn, unit length of the file
    },
}

KEYS = {"signatures": ("digest", "shape")}

INDEXES = (
    "CREATE INDEX shapes_by_content ON shapes (content_hash)",
    "CREATE INDEX shapes_by_status ON shapes (status, id)",
    "CREATE INDEX incomplete_shapes ON shapes (id) WHERE grade <> 'good'",
)

# Number of rows that are read at a time.
READ_AT_ONCE = 1000


def created(
    settings: Mapping[str, str], words: Mapping[str, str], further: Iterable[str]
) -> Iterator[tuple[str, Sequence[object]]]:
    """Yield the statements, in the words of a database, that create all tables and store the settings."""
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
    if int(version) != SCHEMA_VERSION:
        raise CatalogueError(
            f"{location} was written by another version of pcretrieve (schema {version}, this one knows "
            f"{SCHEMA_VERSION}): use that version, or ingest into a new catalogue"
        )


def damaged(location: str, how: str) -> CatalogueError:
    """The error for a catalogue with invalid content."""
    return CatalogueError(
        f"{location} is damaged ({how}): restore a copy, or ingest into a new catalogue"
    )


class UnknownShape(InputError, KeyError):
    """An id that a catalogue does not have, which is a mapping."""


class ChangedRow(CatalogueError):
    """Texts or numbers of a row that are not those that were stored, as by a flipped bit on the disk."""


class TransactionLost(CatalogueError):
    """The connection to a database was lost before a transaction was stored: it can be run again."""


Given = ParamSpec("Given")
Answer = TypeVar("Answer")


def repeated(operation: Callable[Given, Answer]) -> Callable[Given, Answer]:
    """Run an operation again from its start while its transaction is lost; the database limits the time."""

    @wraps(operation)
    def run(*given: Given.args, **named: Given.kwargs) -> Answer:
        while True:
            with suppress(TransactionLost):
                return operation(*given, **named)

    return run


def changed_row(location: str, how: str) -> ChangedRow:
    """The error for a row that `pcretrieve catalogue check --repair` removes."""
    return ChangedRow(
        f"{location} is damaged ({how}): restore a copy, or repair it: `pcretrieve catalogue check --repair`"
    )


# --- records --------------------------------------------------------------------------------------------

Status = Literal["done", "failed"]

#: The digest under which the signatures by the options of the catalogue are stored.
OWN = "own"


@dataclass(frozen=True, slots=True, eq=False)
class Content:
    """The result of processing a scan.

    signature: (L,) float64, values of the signature by the options of the catalogue.
    thumbnail: a picture of the first surface, a PNG file.
    up: (3,) float64, the direction upwards in it.
    """

    shape: Shape
    signature: FloatArray
    thumbnail: bytes | None = None
    up: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class Record:
    """The provenance of one shape: everything except its arrays.

    area: area of the first surface, in the square of the unit of the scan: see `metres_per_unit`.
    mark, note: what a person decided about the scan, and why: see `mark`.
    """

    id: str
    path: str
    content_hash: str
    label: str | None = None
    status: str = "done"
    stage: str | None = None
    error: str | None = None
    message: str | None = None
    steps: tuple[Step, ...] = ()
    area: float | None = None
    n_vertices: int | None = None
    n_faces: int | None = None
    euler: int | None = None
    options_digest: str = ""
    versions: dict[str, str] = field(default_factory=dict)
    added: str = ""
    grade: Grade | None = None
    stamp: str | None = None
    mark: str | None = None
    note: str | None = None

    @property
    def is_incomplete(self) -> bool:
        """Whether the scan is poor or incomplete; false if its grade is not known."""
        return self.grade is not None and not self.grade.is_good

    @property
    def metres_per_unit(self) -> float | None:
        """Length of the unit of the area; metres. None if the format of the file does not have a unit."""
        return next((step.sizes[UNIT] for step in self.steps if UNIT in step.sizes), None)

    @property
    def seconds(self) -> float:
        """Total time of all stages; seconds."""
        return sum(step.seconds for step in self.steps)


@dataclass(frozen=True, slots=True, eq=False)
class Entry:
    """Everything that is stored of one shape, as bytes: signatures by the digest of their options."""

    record: Record
    signatures: Mapping[str, bytes]
    payloads: Mapping[Payload, bytes]


def numbered_id(stem: str, number: int) -> str:
    """The id of one of several files of the same name: ``cat``, ``cat-2``, ``cat-3``."""
    return stem if number == 1 else f"{stem}-{number}"


def free_id(record: Record, is_taken: Callable[[str], bool]) -> str:
    """The id of a record, or the name of its file with a number if another path has this id.

    The number is doubled until it is free and then bisected, because one name may have many numbers.
    """
    if not is_taken(record.id):
        return record.id
    stem, last = Path(record.path).stem, 1
    while is_taken(numbered_id(stem, last)):
        last *= 2
    numbers = range(last // 2 + 1, last)
    first = bisect_left(
        numbers, True, key=lambda number: not is_taken(numbered_id(stem, number))
    )
    return numbered_id(stem, numbers.start + first)


# --- rows -----------------------------------------------------------------------------------------------

SHAPE_COLUMNS = tuple(TABLES["shapes"])[1:]
PROVENANCE_COLUMNS = tuple(TABLES["provenance"])[1:]
#: All rows of records, with the number of the shape first; conditions follow.
RECORDS = (
    f"SELECT number, {', '.join(SHAPE_COLUMNS + PROVENANCE_COLUMNS)} "
    "FROM shapes LEFT JOIN provenance ON shape = number"
)
FIELDS = [one.name for one in fields(Record) if one.name != "grade"]
STEP_FIELDS = [one.name for one in fields(Step)]

# Columns with the checksum: not itself, and not the stamp, without which a file is read once more. A mark
# counts where there is one, so that a record without has the checksum that it had before there were marks.
SUMMED = [
    name
    for name in SHAPE_COLUMNS + PROVENANCE_COLUMNS
    if name not in ("checksum", "stamp", "mark", "note")
]

# Numbers with a fraction, which databases return as float, also if they were stored as int.
REAL = {name for name, kind in TABLES["shapes"].items() if kind == "double precision"}


def checksum(row: Mapping[str, Any]) -> int:
    """The checksum of the values of a record, by which readers notice changed bits."""
    values = [
        float(row[name]) if name in REAL and isinstance(row[name], int) else row[name]
        for name in SUMMED
    ]
    if row["mark"] is not None:
        values += [row["mark"], row["note"]]
    # PostgreSQL cannot store the character 0, in the place of which it has the symbol for it.
    return zlib.crc32(json.dumps(values).replace("\\u0000", "\\u2400").encode())


def row_of(record: Record) -> dict[str, Any]:
    """The values of a record, by column."""
    grade = record.grade
    # Not by asdict, which copies the steps and takes most of the time of a merge.
    row = {name: getattr(record, name) for name in FIELDS} | {
        "steps": json.dumps(
            [{name: getattr(step, name) for name in STEP_FIELDS} for step in record.steps]
        ),
        "versions": json.dumps(record.versions),
        "grade": None if grade is None else grade.name,
        "expected_error": None if grade is None else grade.error,
        "reasons": None if grade is None else json.dumps(grade.reasons),
        # A column of its own, so that the units of a large catalogue are known without its provenance.
        "metres_per_unit": record.metres_per_unit,
    }
    row["checksum"] = checksum(row)
    return row


def record_of(row: Sequence[Any], location: str) -> Record:
    """The record of a row of the result of the query `RECORDS`."""
    values = dict(zip(SHAPE_COLUMNS + PROVENANCE_COLUMNS, row[1:], strict=True))
    # Without steps, there is no row of its provenance.
    if values["steps"] is None or checksum(values) != values["checksum"]:
        raise changed_row(
            location,
            f"shape {values['id']!r}: its record has changed since it was stored",
        )
    grade = None
    if values["grade"] is not None:
        grade = Grade(
            values["grade"], values["expected_error"], json.loads(values["reasons"])
        )
    decoded = {
        "steps": tuple(
            Step(**s | {"notes": tuple(s["notes"])}) for s in json.loads(values["steps"])
        ),
        "versions": json.loads(values["versions"]),
        "grade": grade,
    }
    return Record(**{name: values[name] for name in FIELDS} | decoded)


# --- options ---------------------------------------------------------------------------------------------


def settings_of(options: PipelineOptions) -> dict[str, str]:
    """The settings of a catalogue that is built with some options."""
    return {"options": options.model_dump_json(), "numbers_version": str(NUMBERS_VERSION)}


def stored_options(
    location: str,
    settings: Mapping[str, str],
    given: PipelineOptions | None = None,
    *,
    any_numbers: bool = False,
) -> PipelineOptions:
    """The options that a catalogue was built with."""
    try:
        values, numbers = (
            json.loads(settings["options"]),
            int(settings["numbers_version"]),
        )
        own = PipelineOptions(**values)
    except OptionError as error:
        raise CatalogueError(
            f"{location} was built by a pcretrieve with other options ({error.message}): ingest into a "
            "new catalogue, or use that version"
        ) from error
    except (KeyError, TypeError, ValueError) as error:
        raise damaged(location, "it has no readable options") from error
    if numbers != NUMBERS_VERSION and not any_numbers:
        raise CatalogueError(
            f"{location} was built by a pcretrieve whose numbers differ (version {numbers} there, "
            f"{NUMBERS_VERSION} here): ingest into a new catalogue; `list`, `show` and `export` read this one"
        )
    if given is not None:
        check_options(location, own, given)
    return own


def check_options(location: str, own: PipelineOptions, given: PipelineOptions) -> None:
    """Check that shapes that are processed by some options can be stored in a catalogue."""
    if (given.signature_digest, given.catalogue) != (own.signature_digest, own.catalogue):
        difference = "; ".join(options_difference(own, given))
        raise CatalogueError(
            f"{location} was built with other options: {difference}. Ingest into a new catalogue, or leave "
            "the options out to use its own"
        )
