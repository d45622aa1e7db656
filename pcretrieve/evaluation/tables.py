"""Table of signatures → rankings and retrieval measures."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from pcretrieve.evaluation.folds import within_class_distances
from pcretrieve.evaluation.measures import RetrievalMeasures, evaluate_rankings
from pcretrieve.evaluation.rankings import Rankings, rank, rank_gallery
from pcretrieve.evaluation.reranked import reranked_blocks
from pcretrieve.options import RetrievalOptions
from pcretrieve.retrieval import SignatureIndex, Whitening
from pcretrieve.types import SignatureTable

__all__ = ["evaluate_table", "rank_table", "unsupervised"]


def rank_table(
    table: SignatureTable,
    options: RetrievalOptions | None = None,
    *,
    whitening: Whitening | None = None,
    failed_labels: Iterable[str | None] = (),
    unseen_only: bool = False,
) -> Rankings:
    """Rank a table of signatures for each labelled shape in it.

    Parameters
    ----------
    table : SignatureTable
        Signatures with labels. Shapes without a label are in the gallery, but no queries.
    options : RetrievalOptions, optional
        The distance, and the whitening: ``neighbours`` and ``pca`` are fitted to the whole table,
        ``within-class`` by grouped folds. ``auto`` is ``neighbours``, because the labels are what the
        rankings are compared with.
    whitening : Whitening, optional
        A whitening made before, such as `resolution_whitening`, instead of the one that `options` name. A
        within-class whitening is not used, but is fitted by grouped folds instead.
    failed_labels : iterable of (str or None)
        Classes of the shapes that failed, which count as misses.
    unseen_only : bool, default False
        Whether the gallery of a query has only classes to which a within-class whitening was not fitted, as
        is always so with re-ranking.

    Returns
    -------
    Rankings
        The ranks of the relevant shapes.

    Raises
    ------
    BenchmarkError
        If too few classes have two shapes.
    InputError
        If the whitening was fitted on signatures with other options.
    OptionError
        If the whitening ``resolution`` is asked for and was not made before.
    """
    options = unsupervised(options or RetrievalOptions())
    if (options.whitening if whitening is None else whitening.kind) == "within-class":
        if whitening is not None:
            whitening.check_made_for(table.digest)
        blocks = within_class_distances(table, options, unseen_only=unseen_only or options.rerank != "none")
        return rank_gallery(blocks, table.ids, table.labels, failed_labels=failed_labels)
    if not len(table):
        return rank_gallery((), (), (), failed_labels=failed_labels)
    index = SignatureIndex(table, options, whitening=whitening)
    label_of = dict(zip(table.ids, table.labels, strict=True))
    labels = [label_of[shape_id] for shape_id in index.ids]
    if options.rerank == "none":
        return rank(index, labels, failed_labels=failed_labels)
    labelled = np.flatnonzero([label is not None for label in labels])
    blocks = reranked_blocks(options.rerank, index.blocks, len(index), labelled)
    return rank_gallery(blocks, index.ids, labels, failed_labels=failed_labels)


def unsupervised(options: RetrievalOptions) -> RetrievalOptions:
    """The options of an evaluation: the whitening ``auto`` must not be fitted to the labels of the queries.

    Parameters
    ----------
    options : RetrievalOptions
        The options.

    Returns
    -------
    RetrievalOptions
        The same, with ``neighbours`` for ``auto``.
    """
    return options.model_copy(update={"whitening": "neighbours"}) if options.whitening == "auto" else options


def evaluate_table(
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
        Signatures with labels.
    options : RetrievalOptions, optional
        The distance and the whitening.
    whitening : Whitening, optional
        A whitening made before.
    failed_labels : iterable of (str or None)
        Classes of the shapes that failed.

    Returns
    -------
    RetrievalMeasures
        Of the rankings by `rank_table`, which explains the parameters and the errors.
    """
    return evaluate_rankings(rank_table(table, options, whitening=whitening, failed_labels=failed_labels))
