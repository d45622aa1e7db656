"""Grouped folds of classes, with which a within-class whitening is evaluated.

A within-class whitening is fitted to labels. To keep training and test classes apart, the classes are
assigned to folds; the queries of a fold are ranked against the whole gallery after the whitening that is
fitted to the shapes of the other folds (grouped cross-validation). The measures tend to be lower than for a
gallery of new shapes: the shapes of the fit, all of which are irrelevant to the query, have smaller distances
after a whitening that was fitted to them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from pcretrieve.errors import BenchmarkError
from pcretrieve.evaluation.rankings import NO_FAILURES, Rankings, Subset, rank_subsets
from pcretrieve.options import RetrievalOptions
from pcretrieve.retrieval import Positions, SignatureIndex, Whitening, fit_whitening
from pcretrieve.retrieval.distances import pairwise_blocks, table_coordinates
from pcretrieve.values import SignatureTable


def grouped_folds(
    labels: Iterable[str | None], options: RetrievalOptions
) -> tuple[tuple[str, ...], ...]:
    """Assign classes, with all their shapes, to folds."""
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


def within_class_folds(
    table: SignatureTable, options: RetrievalOptions
) -> Iterator[tuple[Positions, Whitening]]:
    """The positions (q,) of the labelled shapes of each fold, and the whitening of the other folds."""
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
        yield np.flatnonzero(scored), whitening


def within_class_subsets(
    table: SignatureTable, options: RetrievalOptions, *, among_fold: bool
) -> Iterator[Subset]:
    """The distances from the shapes of each fold to all shapes, or among each other, by its whitening.

    Re-ranking is among each other: the classes of the fit are dense, since their labels were used, and would
    distort what it measures, neighbourhoods.
    """
    logs = table_coordinates(table, options.distance)
    for queries, whitening in within_class_folds(table, options):
        members = queries if among_fold else np.arange(len(table))
        rows = np.arange(len(queries)) if among_fold else queries
        yield Subset(
            members, pairwise_blocks(options.distance, whitening.apply(logs[members]), rows)
        )


def rank_table(
    table: SignatureTable,
    options: RetrievalOptions | None = None,
    *,
    whitening: Whitening | None = None,
    failed: Mapping[str, str | None] = NO_FAILURES,
) -> tuple[Rankings, Rankings]:
    """The rankings of a table by some options, and those without re-ranking.

    Distances are computed once, and a within-class whitening is fitted once for each fold. With re-ranking
    the gallery of a query is its fold, which has only classes to which the whitening was not fitted.
    """
    options = (options or RetrievalOptions()).without_labels
    again = options.rerank != "none"
    if (options.whitening if whitening is None else whitening.kind) == "within-class":
        if whitening is not None:
            whitening.check_made_for(table.digest)
        subsets = within_class_subsets(table, options, among_fold=again)
        return rank_subsets(subsets, table.ids, table.labels, again=again, failed=failed)
    if not len(table):
        return rank_subsets((), (), (), failed=failed)
    index = SignatureIndex(table, options, whitening=whitening)
    label_of = dict(zip(table.ids, table.labels, strict=True))
    labels = [label_of[shape_id] for shape_id in index.ids]
    queries = None if again else np.flatnonzero([label is not None for label in labels])
    everything = Subset(np.arange(len(index)), index.blocks(queries))
    return rank_subsets([everything], index.ids, labels, again=again, failed=failed)
