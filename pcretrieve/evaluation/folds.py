"""Grouped folds of classes, with which a within-class whitening is evaluated.

A within-class whitening is fitted to labels. To keep training and test classes apart, the classes are
assigned to folds; the queries of a fold are ranked against the whole gallery after the whitening that is
fitted to the shapes of the other folds (grouped cross-validation). The measures tend to be lower than for a
gallery of new shapes: the shapes of the fit, all of which are irrelevant to the query, have smaller distances
after a whitening that was fitted to them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from pcretrieve.errors import BenchmarkError
from pcretrieve.evaluation.reranked import Subset
from pcretrieve.options import RetrievalOptions
from pcretrieve.retrieval import (
    DistanceBlock,
    Positions,
    Whitening,
    fit_whitening,
    pairwise_blocks,
    table_coordinates,
)
from pcretrieve.values import SignatureTable

__all__ = [
    "Fold",
    "grouped_folds",
    "within_class_distances",
    "within_class_folds",
    "within_class_subsets",
]


class Fold(NamedTuple):
    """Queries, and a whitening that was fitted without the shapes of their classes.

    queries: (q,) intp, positions in the table.
    """

    queries: Positions
    whitening: Whitening


def grouped_folds(
    labels: Iterable[str | None], options: RetrievalOptions | None = None
) -> tuple[tuple[str, ...], ...]:
    """Assign classes, with all their shapes, to folds."""
    options = options or RetrievalOptions()
    n_folds = options.n_folds
    sizes = Counter(label for label in labels if label is not None)
    shared = sorted(label for label, size in sizes.items() if size > 1)
    single = sorted(label for label, size in sizes.items() if size == 1)
    if len(shared) < n_folds:
        raise BenchmarkError(
            f"{n_folds} folds need at least {n_folds} classes with 2 shapes or more, got {len(shared)}; "
            "label more shapes, ask for fewer folds, or use the whitening 'pca' or 'none'"
        )
    rng = np.random.default_rng(options.fold_seed)
    dealt = [shared[i] for i in rng.permutation(len(shared))] + single
    return tuple(tuple(dealt[fold::n_folds]) for fold in range(n_folds))


def within_class_folds(table: SignatureTable, options: RetrievalOptions | None = None) -> Iterator[Fold]:
    """The labelled shapes of each fold, with the within-class whitening of the other folds."""
    options = options or RetrievalOptions()
    logs = table_coordinates(table, options.distance)
    for classes in grouped_folds(table.labels, options):
        scored = np.array([label in classes for label in table.labels])
        fitted = np.flatnonzero([label is not None for label in table.labels] & ~scored)
        whitening = fit_whitening(
            "within-class",
            logs[fitted],
            [table.labels[position] for position in fitted],
            shrinkage=options.shrinkage,
            metric=table.metric,
            options_digest=table.digest,
        )
        yield Fold(np.flatnonzero(scored), whitening)


def within_class_distances(
    table: SignatureTable, options: RetrievalOptions | None = None
) -> Iterator[DistanceBlock]:
    """Distances from each labelled shape to the whole table, after the whitening of its fold."""
    options = options or RetrievalOptions()
    logs = table_coordinates(table, options.distance)
    for fold in within_class_folds(table, options):
        yield from pairwise_blocks(options.distance, fold.whitening.apply(logs), fold.queries)


def within_class_subsets(table: SignatureTable, options: RetrievalOptions | None = None) -> Iterator[Subset]:
    """The shapes of each fold, and their distances after its whitening.

    Shapes of the fit are left out, because their classes are dense, since their labels were used, and would
    distort what re-ranking measures: neighbourhoods.
    """
    options = options or RetrievalOptions()
    logs = table_coordinates(table, options.distance)
    for fold in within_class_folds(table, options):
        whitened = fold.whitening.apply(logs[fold.queries])
        own = np.arange(len(fold.queries))
        yield Subset(fold.queries, pairwise_blocks(options.distance, whitened, own))
