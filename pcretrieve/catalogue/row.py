"""A shape ↔ the values of its row."""

from __future__ import annotations

import io
import json
from dataclasses import asdict, fields
from datetime import datetime, timezone
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pcretrieve.catalogue.record import Content, Record
from pcretrieve.catalogue.surfaces import row_arrays
from pcretrieve.types import Step

__all__ = ["RECORD_COLUMNS", "packed", "record_of", "row_of", "unpacked"]

RECORD_COLUMNS = tuple(column.name for column in fields(Record))


def row_of(record: Record, content: Content | None, options_digest: str) -> dict[str, Any]:
    """The values of a shape's row by column, added now; without arrays where `content` is None."""
    row: dict[str, Any] = asdict(record) | {
        "steps": json.dumps([asdict(step) for step in record.steps]),
        "versions": json.dumps(record.versions),
        "options_digest": options_digest,
        "added": datetime.now(timezone.utc).isoformat(timespec="seconds"),
    }
    if content is None:
        return row
    shape = content.shape
    return row | {
        "area": shape.area,
        "n_vertices": len(shape.mesh.vertices),
        "n_faces": len(shape.mesh.faces),
        "euler": shape.mesh.euler_characteristic,
        "signature": packed(values=content.signature),
        **{column: packed(**arrays) for column, arrays in row_arrays(shape).items()},
    }


def record_of(row: tuple[Any, ...]) -> Record:
    """The record that the columns `RECORD_COLUMNS` hold; ValueError, TypeError or KeyError if damaged."""
    values = dict(zip(RECORD_COLUMNS, row, strict=True))
    steps = [Step(**step | {"notes": tuple(step["notes"])}) for step in json.loads(values["steps"])]
    return Record(**values | {"steps": tuple(steps), "versions": json.loads(values["versions"])})


def packed(**arrays: Any) -> bytes:
    """Arrays as one compressed ``.npz`` archive."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


def unpacked(blob: bytes) -> dict[str, NDArray[Any]]:
    """The arrays of a ``.npz`` archive, none of which may hold objects."""
    with np.load(io.BytesIO(blob), allow_pickle=False) as archive:
        return cast("dict[str, NDArray[Any]]", dict(archive))
