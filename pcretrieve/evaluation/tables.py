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
from pcretrieve.values import SignatureTable

__all__ = ["evaluate_table", "rank_table", "rerank_table", "unsupervised"]


def rank_table(
    table: SignatureTable,
    options: RetrievalOptions | None = None,
    *,
    whitening: Whitening | None = None,
    failed: Mapping[str, str | None] = NO_FAILURES,
) -> Rankings:
    """Rank a table of signatures for each labelled shape in it."""
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
    """The options of an evaluation: whitening ``auto`` must not be fitted to the labels of the queries."""
    return options.model_copy(update={"whitening": "neighbours"}) if options.whitening == "auto" else options


def evaluate_table(
    table: SignatureTable,
    options: RetrievalOptions | None = None,
    *,
    whitening: Whitening | None = None,
    failed: Mapping[str, str | None] = NO_FAILURES,
) -> RetrievalMeasures:
    """Retrieval measures of a table of signatures."""
    return evaluate_rankings(rank_table(table, options, whitening=whitening, failed=failed))
