"""Table of signatures → rankings and retrieval measures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from pcretrieve.evaluation.folds import within_class_distances, within_class_subsets
from pcretrieve.evaluation.measures import RetrievalMeasures, evaluate_rankings
from pcretrieve.evaluation.rankings import NO_FAILURES, Rankings, rank, rank_gallery
from pcretrieve.evaluation.reranked import Subset, rank_subsets
from pcretrieve.options import RetrievalOptions
from pcretrieve.retrieval import SignatureIndex, Whitening
from pcretrieve.types import SignatureTable

__all__ = ["evaluate_table", "rank_table", "rerank_table", "unsupervised"]


def rank_table(
    table: SignatureTable,
    options: RetrievalOptions | None = None,
    *,
    whitening: Whitening | None = None,
    failed: Mapping[str, str | None] = NO_FAILURES,
) -> Rankings:
    """Rank a table of signatures for each labelled shape in it.

    Parameters
    ----------
    table : SignatureTable
        Signatures with labels. Shapes without a label are in the gallery, but no queries.
    options : RetrievalOptions, optional
        The distance, and the whitening: ``neighbours`` and ``pca`` are fitted to the whole table,
        ``within-class`` by grouped folds. ``auto`` is ``neighbours``, because the labels are what the
        rankings are compared with. With a re-ranking, as in `rerank_table`.
    whitening : Whitening, optional
        A whitening made before, such as `resolution_whitening`, instead of the one that `options` name. A
        within-class whitening is not used, but is fitted by grouped folds instead.
    failed : mapping of str to (str or None), optional
        Classes by id of the shapes that failed, which count as misses.

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
    if options.rerank != "none":
        methods = (options.rerank,)
        return rerank_table(table, methods, options, whitening=whitening, failed=failed)[options.rerank]
    if _is_within_class(table, options, whitening):
        return rank_gallery(within_class_distances(table, options), table.ids, table.labels, failed=failed)
    if not len(table):
        return rank_gallery((), (), (), failed=failed)
    index = SignatureIndex(table, options, whitening=whitening)
    return rank(index, _labels(index, table), failed=failed)


def rerank_table(
    table: SignatureTable,
    methods: Sequence[str],
    options: RetrievalOptions | None = None,
    *,
    whitening: Whitening | None = None,
    failed: Mapping[str, str | None] = NO_FAILURES,
) -> dict[str, Rankings]:
    """Rank a table of signatures for each labelled shape in it, by plain and by re-ranked lists.

    Distances are computed once, and a within-class whitening is fitted once for each fold. The gallery of a
    query then has only classes to which the whitening was not fitted, which are its fold.

    Parameters
    ----------
    table : SignatureTable
        As for `rank_table`.
    methods : sequence of str
        Names in `pcretrieve.retrieval.RERANKINGS`; ``none`` for plain lists.
    options : RetrievalOptions, optional
        The distance and the whitening, as for `rank_table`.
    whitening : Whitening, optional
        A whitening made before.
    failed : mapping of str to (str or None), optional
        Classes by id of the shapes that failed.

    Returns
    -------
    dict of str to Rankings
        The ranks of the relevant shapes, by the name of the method.
    """
    options = unsupervised(options or RetrievalOptions())
    if _is_within_class(table, options, whitening):
        subsets = within_class_subsets(table, options)
        return rank_subsets(subsets, table.ids, table.labels, methods, failed=failed)
    if not len(table):
        return rank_subsets((), (), (), methods, failed=failed)
    index = SignatureIndex(table, options, whitening=whitening)
    everything = Subset(np.arange(len(index)), index.blocks())
    return rank_subsets([everything], index.ids, _labels(index, table), methods, failed=failed)


def _is_within_class(table: SignatureTable, options: RetrievalOptions, whitening: Whitening | None) -> bool:
    """Whether a whitening is fitted by grouped folds."""
    if (options.whitening if whitening is None else whitening.kind) != "within-class":
        return False
    if whitening is not None:
        whitening.check_made_for(table.digest)
    return True


def _labels(index: SignatureIndex, table: SignatureTable) -> list[str | None]:
    """The classes of the table in the order of its index."""
    label_of = dict(zip(table.ids, table.labels, strict=True))
    return [label_of[shape_id] for shape_id in index.ids]


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
    failed: Mapping[str, str | None] = NO_FAILURES,
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
    failed : mapping of str to (str or None), optional
        Classes by id of the shapes that failed.

    Returns
    -------
    RetrievalMeasures
        Of the rankings by `rank_table`, which explains the parameters and the errors.
    """
    return evaluate_rankings(rank_table(table, options, whitening=whitening, failed=failed))
