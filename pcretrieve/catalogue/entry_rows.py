"""Reading of everything that an SQLite file has of some shapes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from pcretrieve.catalogue.record import Record
from pcretrieve.catalogue.rows import PAYLOADS, Entry, Payload

__all__ = ["entries_of"]

# Cross joins, because SQLite would read all signatures for each shape.
SIGNATURES = (
    "SELECT id, digest, value FROM shapes CROSS JOIN descriptors CROSS JOIN signatures "
    "ON descriptor = descriptors.number AND shape = shapes.number"
)


def entries_of(records: Sequence[Record], each: Callable[[str, Sequence[str]], Iterable[Any]]) -> list[Entry]:
    """The signatures and the payloads of some records, within a transaction that has begun."""
    ids = [record.id for record in records]
    signatures: dict[str, dict[str, bytes]] = {}
    payloads: dict[str, dict[Payload, bytes]] = {}
    for shape_id, digest, value in each(SIGNATURES, ids):
        signatures.setdefault(shape_id, {})[digest] = value
    for name in PAYLOADS:
        for shape_id, arrays in each(
            f"SELECT id, arrays FROM shapes CROSS JOIN {name} ON shape = number", ids
        ):
            payloads.setdefault(shape_id, {})[name] = arrays
    return [Entry(one, signatures.get(one.id, {}), payloads.get(one.id, {})) for one in records]
