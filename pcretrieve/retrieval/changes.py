"""Indexes with more or fewer shapes, which need not be built again."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable

import numpy as np

from pcretrieve.errors import InputError
from pcretrieve.retrieval.distances import table_coordinates
from pcretrieve.retrieval.index import NO_SHAPES, SignatureIndex
from pcretrieve.retrieval.names import Names
from pcretrieve.retrieval.ranking import position_of
from pcretrieve.retrieval.whitened import WhitenedTable
from pcretrieve.values import SignatureTable

__all__ = ["with_shapes", "without_shapes"]


def with_shapes(index: SignatureIndex, table: SignatureTable) -> SignatureIndex:
    """An index with further shapes.

    The whitening and the scores remain those of the shapes for which they were fitted.
    """
    if not len(table):
        return index
    old = index.contents
    old.made_by.check(table)
    if known := [shape_id for shape_id in table.ids if shape_id in old.ids]:
        raise InputError(
            f"the shapes must be new to the index, got {known[0]!r}, which it has; remove it first"
        )
    by_id = sorted(range(len(table)), key=table.ids.__getitem__)
    ids = [table.ids[row] for row in by_id]
    places = np.array([bisect_left(old.ids, shape_id) for shape_id in ids])
    n_values = old.filter.points.shape[1]
    if table.values.shape[1] != n_values:
        raise InputError(
            f"signatures must have {n_values} values, as those of the index have, got {table.values.shape[1]}"
        )
    points = old.whitening.apply(table_coordinates(table, index.distance)[by_id])
    # Each shape moves by the number of those that come before it.
    moved = np.arange(len(old.ids)) + np.searchsorted(places, np.arange(len(old.ids)), side="right")
    rows = places + np.arange(len(places))
    new = old.filter.extended(
        np.insert(old.filter.points, places, points, axis=0), moved.astype(np.int32), rows.astype(np.int32)
    )
    names = old.ids.inserted(Names.of(ids), places)
    return SignatureIndex.of_contents(WhitenedTable(old.made_by, names, old.whitening, new, old.scores))


def without_shapes(index: SignatureIndex, ids: Iterable[str]) -> SignatureIndex:
    """An index without some of its shapes.

    The whitening and the scores remain those of the shapes for which they were fitted.
    """
    old = index.contents
    keep = np.ones(len(index), dtype=bool)
    for shape_id in ids:
        keep[position_of(old.ids, shape_id)] = False
    if not keep.any():
        raise InputError(NO_SHAPES)
    table = WhitenedTable(old.made_by, old.ids.kept(keep), old.whitening, old.filter.kept(keep), old.scores)
    return SignatureIndex.of_contents(table)
