"""Records ↔ the values of their rows in SQL."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

from pcretrieve.catalogue.opening import damaged
from pcretrieve.catalogue.record import Record
from pcretrieve.types import Step, Verdict

__all__ = ["COLUMNS", "LENGTHS", "PROVENANCE_COLUMNS", "RECORDS", "SHAPE_COLUMNS", "record_of", "row_of"]

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
)
PROVENANCE_COLUMNS = ("steps", "options_digest", "versions", "added", "reasons")
COLUMNS = (*SHAPE_COLUMNS, *PROVENANCE_COLUMNS)
FIELDS = [field.name for field in fields(Record)]
STEP_FIELDS = [field.name for field in fields(Step)]
#: The bytes of a record.
LENGTHS = " + ".join(f"ifnull(length(CAST({name} AS BLOB)), 0)" for name in COLUMNS)
#: All records; conditions follow.
RECORDS = f"SELECT {', '.join(COLUMNS)} FROM shapes LEFT JOIN provenance ON shape = number"


def row_of(record: Record) -> dict[str, Any]:
    """The values of a record, by column.

    Parameters
    ----------
    record : Record
        The record.

    Returns
    -------
    dict of str to value
        The columns of `SHAPE_COLUMNS` and `PROVENANCE_COLUMNS`.
    """
    verdict = record.verdict
    # Not by asdict, which copies the steps and takes most of the time of a merge.
    return {name: getattr(record, name) for name in FIELDS} | {
        "steps": json.dumps([{name: getattr(step, name) for name in STEP_FIELDS} for step in record.steps]),
        "versions": json.dumps(record.versions),
        "judgement": None if verdict is None else verdict.judgement,
        "uncertainty": None if verdict is None else verdict.uncertainty,
        "reasons": None if verdict is None else json.dumps(verdict.reasons),
        # A column of its own, so that the units of a large catalogue are known without its provenance.
        "metres_per_unit": record.metres_per_unit,
    }


def record_of(row: Sequence[Any], location: str) -> Record:
    """The record of a row of the result of the query `RECORDS`.

    Parameters
    ----------
    row : sequence
        The values of `SHAPE_COLUMNS` and `PROVENANCE_COLUMNS`.
    location : str
        The catalogue, as the message names it.

    Returns
    -------
    Record
        The record.

    Raises
    ------
    CatalogueError
        If the values are damaged.
    """
    try:
        return _record(row)
    except (ValueError, TypeError, KeyError) as error:
        raise damaged(location, f"shape {row[0]!r} has no readable provenance") from error


def _record(row: Sequence[Any]) -> Record:
    values = dict(zip(COLUMNS, row, strict=True))
    steps = [Step(**step | {"notes": tuple(step["notes"])}) for step in json.loads(values["steps"])]
    del values["metres_per_unit"]  # which a record has in its steps
    judgement, uncertainty, reasons = (values.pop(name) for name in ("judgement", "uncertainty", "reasons"))
    verdict = None if judgement is None else Verdict(judgement, uncertainty, json.loads(reasons))
    fields = {"steps": tuple(steps), "versions": json.loads(values["versions"]), "verdict": verdict}
    return Record(**values | fields)
