"""The measures of two results for the same queries → their differences, with confidence intervals.

A result is how a catalogue, a distance matrix or other settings rank the shapes. The differences of each
query are resampled, so that what makes a query easy or hard for both results does not widen the intervals.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pcretrieve.errors import InputError
from pcretrieve.evaluation.intervals import LEVEL, bootstrap_interval
from pcretrieve.evaluation.measures import QueryScores
from pcretrieve.values import FloatArray
from pcretrieve.values.base import Value

__all__ = ["Change", "Comparison", "compare_scores"]

# Largest number of shapes in the message about classes that differ.
QUOTED = 3


class Change(NamedTuple):
    """The average precision of one query in both results."""

    shape_id: str
    label: str
    first: float
    second: float


@dataclass(frozen=True, slots=True, eq=False)
class Comparison(Value):
    """Two results for the same queries. The six measures are in the order of `MEASURES`.

    first, second: (6,) float64, means over the queries that both results have.
    difference: (6,) float64, second minus first.
    interval: (2, 6) float64, lower and upper ends of the confidence intervals of the differences.
    """

    first: FloatArray
    second: FloatArray
    difference: FloatArray
    interval: FloatArray
    level: float
    changes: tuple[Change, ...]
    only_first: tuple[str, ...]
    only_second: tuple[str, ...]


def compare_scores(
    first: QueryScores,
    second: QueryScores,
    *,
    level: float = LEVEL,
    rng: np.random.Generator | None = None,
) -> Comparison:
    """Compare two results query by query."""
    row = {shape_id: number for number, shape_id in enumerate(second.ids)}
    common = [number for number, shape_id in enumerate(first.ids) if shape_id in row]
    if not common:
        raise InputError(
            f"two results must have queries in common, got none of {len(first.ids)} and {len(second.ids)}: "
            "compare results of the same shapes"
        )
    other = [row[first.ids[number]] for number in common]
    differing = [
        first.ids[a] for a, b in zip(common, other, strict=True) if first.labels[a] != second.labels[b]
    ]
    if differing:
        raise InputError(
            f"a query must have the same class in both results, {len(differing)} have another, such as "
            f"{', '.join(differing[:QUOTED])}: give both the same labels"
        )
    one, two = first.columns[common], second.columns[other]  # (Q, 6)
    changes = [
        Change(first.ids[a], first.labels[a], float(first.ap[a]), float(second.ap[b]))
        for a, b in zip(common, other, strict=True)
    ]
    changes.sort(key=lambda change: (-abs(change.second - change.first), change.shape_id))
    both = {first.ids[number] for number in common}
    return Comparison(
        first=one.mean(axis=0),
        second=two.mean(axis=0),
        difference=(two - one).mean(axis=0),
        interval=bootstrap_interval(two - one, level=level, rng=rng),
        level=level,
        changes=tuple(changes),
        only_first=tuple(shape_id for shape_id in first.ids if shape_id not in both),
        only_second=tuple(shape_id for shape_id in second.ids if shape_id not in both),
    )
