"""Checksums of the text and the numbers of a row, by which `check` and readers notice changed bits."""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from typing import Any

__all__ = ["CHECKSUM_COLUMNS", "changed_parts", "checksum", "checksums_of"]

#: Columns of the table `shapes` with the checksums of the parts of a row, by part. The first three have the
#: column of the same name; the record has the others. The parts are separate because a path and a label are
#: replaced without the record, and because a repair depends on the part.
CHECKSUM_COLUMNS = {
    "id": "id_checksum",
    "path": "path_checksum",
    "label": "label_checksum",
    "record": "record_checksum",
}

# Numbers with a fraction, which SQLite returns as float, also if they were stored as int.
REAL = ("area", "uncertainty", "metres_per_unit")

# The columns of a record. The stamp of its file is none of them: with another stamp, the file is read once
# more. A column of a later schema version must not become one of them, because stored checksums lack it.
RECORD = (
    *("content_hash", "status", "stage", "error", "message", "n_vertices", "n_faces", "euler", "judgement"),
    *REAL,
    *("steps", "options_digest", "versions", "added", "reasons"),
)


def checksum(value: object) -> int:
    """The checksum of a value, or of a list of values."""
    # PostgreSQL cannot store the character 0, in the place of which it has the symbol for it.
    text = json.dumps(value).replace("\\u0000", "\\u2400")
    return zlib.crc32(text.encode())


def checksums_of(row: Mapping[str, Any]) -> dict[str, int]:
    """The checksums of a row."""
    values = [float(row[name]) if name in REAL and row[name] is not None else row[name] for name in RECORD]
    parts = {**{name: row[name] for name in ("id", "path", "label")}, "record": values}
    return {CHECKSUM_COLUMNS[name]: checksum(value) for name, value in parts.items()}


def changed_parts(row: Mapping[str, Any]) -> tuple[str, ...]:
    """The parts of a row that differ from what was stored."""
    found = checksums_of(row)
    return tuple(name for name, column in CHECKSUM_COLUMNS.items() if row[column] != found[column])
