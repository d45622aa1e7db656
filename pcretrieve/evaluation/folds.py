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

from pcretrieve.errors import BenchmarkError, OptionError
from pcretrieve.evaluation.measures import RetrievalMeasures, evaluate_rankings
from pcretrieve.evaluation.rankings import DistanceBlock, Positions, Rankings, rank_gallery
from pcretrieve.retrieval import Whitening, fit_whitening, log_signatures, pairwise
from pcretrieve.types import FloatArray, SignatureTable

__all__ = [
    "Fold",
    "evaluate",
    "grouped_folds",
    "rank_table",
    "table_distances",
    "within_class_distances",
    "within_class_folds",
]

N_FOLDS = 5

# Which classes share a fold moves a score by a few thousandths; a fixed seed makes scores comparable.
FOLD_SEED = 0

# Distances held at once: 32 MB.
BLOCK_DISTANCES = 2**22


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
    labels: Iterable[str | None], *, n_folds: int = N_FOLDS, rng: np.random.Generator | None = None
) -> tuple[tuple[str, ...], ...]:
    """Deal classes, not shapes, into folds.

    Parameters
    ----------
    labels : iterable of (str or None)
        None is ignored.
    n_folds : int
        At least 2.
    rng : numpy.random.Generator, optional
        Shuffles the classes; by default always in the same way. The order of `labels` does not matter.

    Returns
    -------
    tuple of tuples of str
        The classes of each fold. Those with two shapes or more are spread evenly, and so are the others.

    Raises
    ------
    OptionError
        For fewer than 2 folds.
    BenchmarkError
        Where fewer classes than folds have two shapes.
    """
    if n_folds < 2:
        raise OptionError(f"n_folds must be at least 2, got {n_folds}")
    sizes = Counter(label for label in labels if label is not None)
    shared = sorted(label for label, size in sizes.items() if size > 1)
    single = sorted(label for label, size in sizes.items() if size == 1)
    if len(shared) < n_folds:
        raise BenchmarkError(
            f"{n_folds} folds need at least {n_folds} classes with 2 shapes or more, got {len(shared)}; "
            "label more shapes, ask for fewer folds, or use the whitening 'pca' or 'none'"
        )
    rng = np.random.default_rng(FOLD_SEED) if rng is None else rng
    dealt = [shared[i] for i in rng.permutation(len(shared))] + single
    return tuple(tuple(dealt[fold::n_folds]) for fold in range(n_folds))


def within_class_folds(
    table: SignatureTable,
    *,
    n_folds: int = N_FOLDS,
    damping: float | None = None,
    rng: np.random.Generator | None = None,
) -> Iterator[Fold]:
    """The labelled shapes of each fold, with the within-class whitening fitted on the other folds.

    `damping` is that of `fit_whitening`, `n_folds` and `rng` those of `grouped_folds`.
    """
    logs = log_signatures(table.values)
    for classes in grouped_folds(table.labels, n_folds=n_folds, rng=rng):
        scored = np.array([label in classes for label in table.labels])
        fitted = np.flatnonzero([label is not None for label in table.labels] & ~scored)
        whitening = fit_whitening(
            "within-class",
            logs[fitted],
            [table.labels[position] for position in fitted],
            damping=damping,
            options_digest=table.digest,
        )
        yield Fold(np.flatnonzero(scored), whitening)


def within_class_distances(
    table: SignatureTable,
    distance: str = "log",
    *,
    n_folds: int = N_FOLDS,
    damping: float | None = None,
    rng: np.random.Generator | None = None,
) -> Iterator[DistanceBlock]:
    """Distances of each labelled shape to the whole gallery, whitened by its fold of `within_class_folds`."""
    logs = log_signatures(table.values)
    for fold in within_class_folds(table, n_folds=n_folds, damping=damping, rng=rng):
        yield from _blocks(distance, fold.whitening.apply(logs), fold.queries)


def table_distances(
    table: SignatureTable,
    distance: str = "log",
    *,
    whitening: Whitening | str = "none",
    damping: float | None = None,
) -> Iterator[DistanceBlock]:
    """Distances of each labelled shape to the whole gallery, in a whitening that knows no labels."""
    if _kind(whitening) == "within-class":
        raise OptionError(
            "whitening must be none or pca here, got 'within-class', which would be scored on the classes "
            "it was fitted on; use within_class_distances"
        )
    logs = log_signatures(table.values)
    if isinstance(whitening, str):
        whitening = fit_whitening(whitening, logs, damping=damping)
    whitened = whitening.apply(logs)
    yield from _blocks(distance, whitened, np.flatnonzero([label is not None for label in table.labels]))


def rank_table(
    table: SignatureTable,
    *,
    distance: str = "log",
    whitening: Whitening | str = "none",
    failed_labels: Iterable[str | None] = (),
    n_folds: int = N_FOLDS,
    damping: float | None = None,
    rng: np.random.Generator | None = None,
) -> Rankings:
    """Rank the whole table for each labelled shape in it; parameters as in `evaluate`."""
    if _kind(whitening) == "within-class":
        blocks = within_class_distances(table, distance, n_folds=n_folds, damping=damping, rng=rng)
    else:
        blocks = table_distances(table, distance, whitening=whitening, damping=damping)
    return rank_gallery(blocks, table.ids, table.labels, failed_labels=failed_labels)


def evaluate(
    table: SignatureTable,
    *,
    distance: str = "log",
    whitening: Whitening | str = "none",
    failed_labels: Iterable[str | None] = (),
    n_folds: int = N_FOLDS,
    damping: float | None = None,
    rng: np.random.Generator | None = None,
) -> RetrievalMeasures:
    """Retrieval measures of a table of signatures.

    Parameters
    ----------
    table : SignatureTable
        With labels; shapes without one are in the gallery, but no queries.
    distance : str
        ``log``, ``d1`` or ``d2``; see `pcretrieve.retrieval.distances`.
    whitening : Whitening or str
        One made before, such as `resolution_whitening`; ``none``; ``pca``, fitted on the whole table; or
        ``within-class``, which is always fitted anew, by grouped folds.
    failed_labels : iterable of (str or None)
        Classes of the shapes that failed, which count as misses.
    n_folds, rng
        As in `grouped_folds`; for ``within-class`` only.
    damping : float, optional
        As in `fit_whitening`.
    """
    return evaluate_rankings(
        rank_table(
            table,
            distance=distance,
            whitening=whitening,
            failed_labels=failed_labels,
            n_folds=n_folds,
            damping=damping,
            rng=rng,
        )
    )


def _kind(whitening: Whitening | str) -> str:
    return whitening if isinstance(whitening, str) else whitening.kind


def _blocks(distance: str, whitened: FloatArray, queries: Positions) -> Iterator[DistanceBlock]:
    """Distances from some rows of `whitened` to all of them, a few rows at a time."""
    rows = max(1, BLOCK_DISTANCES // max(1, len(whitened)))
    for start in range(0, len(queries), rows):
        chunk = queries[start : start + rows]
        yield DistanceBlock(chunk, pairwise(distance, whitened[chunk], whitened))
