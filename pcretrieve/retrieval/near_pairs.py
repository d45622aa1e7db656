"""Pairs of shapes that are nearer than the sum of their errors lets expect, by exact search."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from pcretrieve.retrieval.index import SignatureIndex
from pcretrieve.values import FloatArray, Neighbors

__all__ = ["NearPair", "near_pairs"]

# Number of neighbours that are searched first; it is doubled until they are farther than any pair can be.
FIRST = 4


class NearPair(NamedTuple):
    """Two near shapes."""

    first: str
    second: str
    distance: float
    limit: float


def near_pairs(index: SignatureIndex, errors: FloatArray) -> list[NearPair]:
    """Find all pairs of shapes whose distance is at most that of their errors.

    The errors of two shapes are independent, so that the limit is the root of the sum of their squares.

    errors: (N,) float64, the error of each shape of the index, comparable to its distance; not negative.
    """
    largest = float(errors.max(initial=0))
    found = [
        pair
        for row, shape_id in enumerate(index.ids)
        for pair in _pairs_of(index, shape_id, float(errors[row]), largest, errors)
    ]
    return sorted(found, key=lambda pair: (pair.distance, pair.first, pair.second))


def _pairs_of(
    index: SignatureIndex, shape_id: str, error: float, largest: float, errors: FloatArray
) -> Iterator[NearPair]:
    """The near pairs of a shape with shapes after it in alphabetical order."""
    near = _within(index, shape_id, float(np.hypot(error, largest)))
    for other, distance in zip(near.ids, near.distances.tolist(), strict=True):
        if other > shape_id:
            limit = float(np.hypot(error, errors[index.ids.index(other)]))
            if distance <= limit:
                yield NearPair(shape_id, other, distance, limit)


def _within(index: SignatureIndex, shape_id: str, radius: float) -> Neighbors:
    """All neighbours up to a distance, and perhaps some that are farther."""
    k = FIRST
    while True:
        found = index.nearest(shape_id, k)
        if len(found) == len(index) or found.distances[-1] > radius:
            return found
        k *= 2
