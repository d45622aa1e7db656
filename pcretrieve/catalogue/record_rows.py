"""Records ↔ the values of their rows in SQL."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

from pcretrieve.catalogue.checksums import CHECKSUM_COLUMNS, changed_parts, checksums_of
from pcretrieve.catalogue.defects import ChangedRow
from pcretrieve.catalogue.opening import damaged
from pcretrieve.catalogue.record import Record
from pcretrieve.values import Step, Verdict

__all__ = [
    "CHECKSUMS",
    "COLUMNS",
    "LENGTHS",
    "NUMBERED",
    "PROVENANCE_COLUMNS",
    "RECORDS",
    "SHAPE_COLUMNS",
    "record_of",
    "row_of",
    "with_checksums",
]

#: Columns of the tables `shapes` and `provenance` with the fields of a record.
SHAPE_COLUMNS = (
    "id",
    "path",
    "content_hash",
    "label",
    "status",
    "stage",
    "error",
    "message",
    "area",
    "n_vertices",
    "n_faces",
    "euler",
    "judgement",
    "uncertainty",
    "metres_per_unit",
    "stamp",
    *CHECKSUM_COLUMNS.values(),
)
PROVENANCE_COLUMNS = ("steps", "options_digest", "versions", "added", "reasons")
COLUMNS = (*SHAPE_COLUMNS, *PROVENANCE_COLUMNS)
FIELDS = [field.name for field in fields(Record)]
STEP_FIELDS = [field.name for field in fields(Step)]
#: The bytes of a record.
LENGTHS = " + ".join(f"ifnull(length(CAST({name} AS BLOB)), 0)" for name in COLUMNS)
#: All records; conditions follow.
RECORDS = f"SELECT {', '.join(COLUMNS)} FROM shapes LEFT JOIN provenance ON shape = number"
#: Some of them in ascending order of number, which is the first column.
NUMBERED = (
    f"{RECORDS.replace('SELECT', 'SELECT number,', 1)} WHERE number > :last ORDER BY number LIMIT :limit"
)
#: The statement that stores the checksums of a row.
CHECKSUMS = (
    f"UPDATE shapes SET {', '.join(f'{name} = :{name}' for name in CHECKSUM_COLUMNS.values())} "
    "WHERE number = :number"
)


def row_of(record: Record) -> dict[str, Any]:
    """The values of a record, by column."""
    verdict = record.verdict
    # Not by asdict, which copies the steps and takes most of the time of a merge.
    row = {name: getattr(record, name) for name in FIELDS} | {
        "steps": json.dumps([{name: getattr(step, name) for name in STEP_FIELDS} for step in record.steps]),
        "versions": json.dumps(record.versions),
        "judgement": None if verdict is None else verdict.judgement,
        "uncertainty": None if verdict is None else verdict.uncertainty,
        "reasons": None if verdict is None else json.dumps(verdict.reasons),
        # A column of its own, so that the units of a large catalogue are known without its provenance.
        "metres_per_unit": record.metres_per_unit,
    }
    del row["verdict"]
    return row | checksums_of(row)


def with_checksums(row: Sequence[Any]) -> dict[str, Any]:
    """The parameters of the statement `CHECKSUMS`."""
    number, *values = row
    return {"number": number, **checksums_of(dict(zip(COLUMNS, values, strict=True)))}


def record_of(row: Sequence[Any], location: str) -> Record:
    """The record of a row of the result of the query `RECORDS`."""
    values = dict(zip(COLUMNS, row, strict=True))
    try:
        record = _record(values)
    except (ValueError, TypeError, KeyError) as error:
        raise damaged(location, f"shape {row[0]!r} has no readable provenance") from error
    if changed := changed_parts(values):
        raise ChangedRow(location, values, changed)
    return record


def _record(row: Mapping[str, Any]) -> Record:
    values = {name: value for name, value in row.items() if name not in CHECKSUM_COLUMNS.values()}
    steps = [Step(**step | {"notes": tuple(step["notes"])}) for step in json.loads(values["steps"])]
    del values["metres_per_unit"]  # which a record has in its steps
    judgement, uncertainty, reasons = (values.pop(name) for name in ("judgement", "uncertainty", "reasons"))
    verdict = None if judgement is None else Verdict(judgement, uncertainty, json.loads(reasons))
    fields = {"steps": tuple(steps), "versions": json.loads(values["versions"]), "verdict": verdict}
    return Record(**values | fields)
