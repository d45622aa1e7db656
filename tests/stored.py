"""All that a catalogue has, so that tests can compare two of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from pcretrieve import Catalogue
from pcretrieve.catalogue import Record
from pcretrieve.catalogue.records import Status
from pcretrieve.catalogue.rows import Rows

Everything = dict[str, tuple[Any, ...]]


def content(
    location: str | Path,
) -> list[tuple[Record, dict[str, bytes], dict[Any, bytes]]]:
    """The record, the signatures and the payloads of each shape, in ascending order of id."""
    with Catalogue(location) as store:
        entries = store.rows.entries([origin.id for origin in store.rows.origins()])
        return [(one.record, dict(one.signatures), dict(one.payloads)) for one in entries]


def everything(location: str) -> Everything:
    """The same by id, without times."""
    found = {}
    for record, *rest in content(location):
        steps = tuple(replace(step, seconds=0.0) for step in record.steps)
        found[record.id] = (replace(record, steps=steps, added="", stamp=None), *rest)
    return found


def failure(name: str, **changes: Any) -> Record:
    """The record of a scan that could not be read."""
    record = Record(
        name,
        f"/{name}.ply",
        "",
        status="failed",
        stage="read",
        error="Bad",
        message="why",
    )
    return replace(record, **changes)


def records(rows: Rows, status: Status | None = None) -> list[Record]:
    """The records of all shapes, or of those of one status."""
    _, ids = rows.wanted(state=status or "")
    return [record for page in rows.pages(ids) for record in page]
