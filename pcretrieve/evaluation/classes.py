"""Rankings → the measures of each class, and the classes with which it is confused."""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

import numpy as np

from pcretrieve.evaluation.measures import query_scores
from pcretrieve.evaluation.rankings import Rankings
from pcretrieve.retrieval import Positions
from pcretrieve.values import FloatArray

__all__ = ["ClassMeasures", "Confusion", "class_measures", "confusion"]


class ClassMeasures(NamedTuple):
    """The queries of one class.

    means: (6,) float64, means of the measures over its queries, in the order of `MEASURES`.
    """

    label: str
    n_queries: int
    means: FloatArray
    confused: tuple[tuple[str | None, int], ...]


class Confusion(NamedTuple):
    """Of which class the nearest shape of each query is.

    counts: (n, m) intp, number of queries of a class whose nearest shape is of another, or the same, class.
        Shapes that failed are not counted.
    """

    labels: tuple[str, ...]
    nearest: tuple[str | None, ...]
    counts: Positions


def class_measures(ranked: Rankings) -> tuple[ClassMeasures, ...]:
    """The measures of each class."""
    columns = query_scores(ranked).columns
    labels = np.array(ranked.labels)
    found = []
    for label in np.unique(labels).tolist():
        own = np.flatnonzero(labels == label)
        others = Counter(
            ranked.nearest_labels[query]
            for query in own.tolist()
            if ranked.nearest[query] is not None and ranked.nearest_labels[query] != label
        )
        confused = sorted(others.items(), key=lambda item: (-item[1], item[0] or ""))
        found.append(ClassMeasures(label, len(own), columns[own].mean(axis=0), tuple(confused)))
    return tuple(found)


def confusion(ranked: Rankings) -> Confusion:
    """The confusion matrix of the nearest neighbour."""
    labels = tuple(sorted(set(ranked.labels)))
    known = sorted({*labels, *(label for label in ranked.nearest_labels if label is not None)})
    row = {label: number for number, label in enumerate(labels)}
    column = {label: number for number, label in enumerate((*known, None))}
    counts = np.zeros((len(row), len(column)), dtype=np.intp)
    for label, near, of_class in zip(ranked.labels, ranked.nearest, ranked.nearest_labels, strict=True):
        if near is not None:
            counts[row[label], column[of_class]] += 1
    return Confusion(labels, (*known, None), counts)
