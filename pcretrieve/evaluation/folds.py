"""Evaluation of a table of signatures, and the grouped folds that keep it honest.

Whitening by ``pca`` looks at no label: it is fitted on the whole gallery. Within-class whitening does, so the
classes are dealt into folds, and the queries of each fold are ranked against the whole gallery in the space
whitened by the shapes of the other folds. It is never fitted on the classes it is scored on. If anything the
score is too low: the shapes fitted on lie closer together than new ones do, and all of them are distractors.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from pcretrieve.errors import BenchmarkError
from pcretrieve.evaluation.measures import RetrievalMeasures, evaluate_rankings
from pcretrieve.evaluation.rankings import Rankings, rank, rank_gallery
from pcretrieve.options import RetrievalOptions
from pcretrieve.retrieval import (
    DistanceBlock,
    Positions,
    SignatureIndex,
    Whitening,
    fit_whitening,
    pairwise_blocks,
    table_coordinates,
)
from pcretrieve.types import SignatureTable

__all__ = [
    "Fold",
    "evaluate",
    "grouped_folds",
    "rank_table",
    "within_class_distances",
    "within_class_folds",
]


class Fold(NamedTuple):
    """Queries, and a whitening that has seen no shape of their classes.

    Attributes
    ----------
    queries : (q,) intp
        Positions in the table.
    whitening : Whitening
    """

    queries: Positions
    whitening: Whitening


def grouped_folds(
    labels: Iterable[str | None], options: RetrievalOptions | None = None
) -> tuple[tuple[str, ...], ...]:
    """Deal classes, not shapes, into folds.

    Parameters
    ----------
    labels : iterable of (str or None)
        Their order does not matter; None is ignored.
    options : RetrievalOptions, optional
        How many folds, and the seed of the order in which classes are dealt.

    Returns
    -------
    tuple of tuples of str
        The classes of each fold. Those with two shapes or more are spread evenly, and so are the others.

    Raises
    ------
    BenchmarkError
        Where fewer classes than folds have two shapes.
    """
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
    """The labelled shapes of each fold, with the within-class whitening fitted on the other folds.

    `options` say how the whitening is damped, and how classes are dealt, as in `grouped_folds`.
    """
    options = options or RetrievalOptions()
    logs = table_coordinates(table, options.distance)
    for classes in grouped_folds(table.labels, options):
        scored = np.array([label in classes for label in table.labels])
        fitted = np.flatnonzero([label is not None for label in table.labels] & ~scored)
        whitening = fit_whitening(
            "within-class",
            logs[fitted],
            [table.labels[position] for position in fitted],
            damping=options.damping,
            options_digest=table.digest,
        )
        yield Fold(np.flatnonzero(scored), whitening)


def within_class_distances(
    table: SignatureTable, options: RetrievalOptions | None = None
) -> Iterator[DistanceBlock]:
    """Distances of each labelled shape to the whole gallery, whitened by its fold of `within_class_folds`."""
    options = options or RetrievalOptions()
    logs = table_coordinates(table, options.distance)
    for fold in within_class_folds(table, options):
        yield from pairwise_blocks(options.distance, fold.whitening.apply(logs), fold.queries)


def rank_table(
    table: SignatureTable,
    options: RetrievalOptions | None = None,
    *,
    whitening: Whitening | None = None,
    failed_labels: Iterable[str | None] = (),
) -> Rankings:
    """Rank the whole table for each labelled shape in it; parameters as in `evaluate`."""
    options = options or RetrievalOptions()
    if (options.whitening if whitening is None else whitening.kind) == "within-class":
        if whitening is not None:
            whitening.check_made_for(table.digest)
        blocks = within_class_distances(table, options)
        return rank_gallery(blocks, table.ids, table.labels, failed_labels=failed_labels)
    if not len(table):
        return rank_gallery((), (), (), failed_labels=failed_labels)
    index = SignatureIndex(table, options, whitening=whitening)
    label_of = dict(zip(table.ids, table.labels, strict=True))
    return rank(index, [label_of[shape_id] for shape_id in index.ids], failed_labels=failed_labels)


def evaluate(
    table: SignatureTable,
    options: RetrievalOptions | None = None,
    *,
    whitening: Whitening | None = None,
    failed_labels: Iterable[str | None] = (),
) -> RetrievalMeasures:
    """Retrieval measures of a table of signatures.

    Parameters
    ----------
    table : SignatureTable
        With labels; shapes without one are in the gallery, but no queries.
    options : RetrievalOptions, optional
        The distance, and the whitening: ``pca`` is fitted to the whole table, ``within-class`` by grouped
        folds.
    whitening : Whitening, optional
        One made before, such as `resolution_whitening`, in place of the one that `options` ask for. In place
        of one of ``within-class``, others are fitted by grouped folds.
    failed_labels : iterable of (str or None)
        Classes of the shapes that failed, which count as misses.

    Raises
    ------
    BenchmarkError
        Where too few classes have two shapes.
    InputError
        For a whitening that was fitted on signatures made by other options.
    OptionError
        For the whitening ``resolution`` where it was not made before.
    """
    return evaluate_rankings(rank_table(table, options, whitening=whitening, failed_labels=failed_labels))
