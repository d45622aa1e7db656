"""Reading of the signatures of all shapes of an SQLite file, by columns."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence
from itertools import islice
from operator import lt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcretrieve.catalogue.opening import damaged
from pcretrieve.catalogue.rows import Listed, Revision

__all__ = ["listed"]

# Number of rows that are read at a time.
READ_AT_ONCE = 1000


def listed(connection: sqlite3.Connection, location: str, revision: Revision, digest: str) -> Listed:
    """The signatures of all shapes that did not fail, within a transaction that has begun.

    Returns Listed: the signatures, in ascending order of id.
    """
    numbers: list[int] = []
    ids: list[str] = []
    labels: list[str | None] = []
    known: dict[str | None, str | None] = {}
    # A scan of the table is faster than the index of the status, by which each shape is looked up.
    query = "SELECT number, id, label FROM shapes NOT INDEXED WHERE status = 'done' ORDER BY number"
    for number, shape_id, label in _columns(connection, query):
        numbers += number
        ids += shape_id
        labels += map(known.setdefault, label, label)
    by_id = np.arange(len(ids))
    if not all(map(lt, ids, islice(ids, 1, None))):
        by_id = np.array(sorted(by_id.tolist(), key=ids.__getitem__), np.intp)
        ids, labels = [ids[row] for row in by_id], [labels[row] for row in by_id]
    packed, has = _packed(connection, location, digest, np.array(numbers, np.int64), np.argsort(by_id))
    return Listed(revision, ids, labels, packed, has)


def _packed(
    connection: sqlite3.Connection,
    location: str,
    digest: str,
    numbers: NDArray[np.int64],
    rows: NDArray[np.intp],
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """The signatures of shapes with ascending numbers, one in each row, and a mask of those that exist."""
    query = (
        "SELECT shape, value FROM signatures JOIN descriptors ON number = descriptor WHERE digest = ? "
        "ORDER BY shape"
    )
    has = np.zeros(len(numbers), np.bool_)
    packed = np.zeros((len(numbers), 0), np.uint8)
    for shapes, values in _columns(connection, query, (digest,)):
        if len({*map(len, values)}) > 1 or packed.shape[1] not in (0, len(values[0])):
            raise damaged(location, "signatures by the same options have several lengths")
        if not packed.shape[1]:
            packed = np.zeros((len(numbers), len(values[0])), np.uint8)
        here = rows[np.searchsorted(numbers, shapes)]
        packed[here] = np.frombuffer(b"".join(values), np.uint8).reshape(len(values), -1)
        has[here] = True
    return packed, has


def _columns(
    connection: sqlite3.Connection, query: str, values: Sequence[object] = ()
) -> Iterator[list[list[Any]]]:
    """Yield the result of a query by columns, some rows at a time."""
    cursor = connection.execute(query, values)
    while rows := cursor.fetchmany(READ_AT_ONCE):
        # Faster than zip(*rows), which creates an iterator of each row.
        yield [[row[column] for row in rows] for column in range(len(rows[0]))]
