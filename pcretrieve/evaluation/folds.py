"""Grouped folds of classes, with which a within-class whitening is evaluated.

A within-class whitening is fitted to labels. To keep training and test classes apart, the classes are
assigned to folds; the queries of a fold are ranked against the whole gallery after the whitening that is
fitted to the shapes of the other folds (grouped cross-validation). The measures tend to be lower than for a
gallery of new shapes: the shapes of the fit, all of which are irrelevant to the query, have smaller distances
after a whitening that was fitted to them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pcretrieve.errors import BenchmarkError
from pcretrieve.evaluation.measures import RetrievalMeasures, evaluate_rankings
from pcretrieve.evaluation.rankings import (
    NO_FAILURES,
    Rankings,
    SortedBlock,
    by_distance,
    rank,
    rank_gallery,
    rank_sorted,
)
from pcretrieve.options import RetrievalOptions
from pcretrieve.retrieval import (
    N_RERANKED,
    DistanceBlock,
    NeighbourLists,
    Positions,
    SignatureIndex,
    Whitening,
    fit_whitening,
    pairwise_blocks,
    rerank,
    table_coordinates,
)
from pcretrieve.values import SignatureTable


class Fold(NamedTuple):
    """Queries, and a whitening that was fitted without the shapes of their classes.

    queries: (q,) intp, positions in the table.
    """

    queries: Positions
    whitening: Whitening


class Subset(NamedTuple):
    """Shapes of a gallery that are ranked among each other.

    members: (m,) intp, positions of the shapes in the gallery.
    """

    members: Positions
    blocks: Iterable[DistanceBlock]


def grouped_folds(labels: Iterable[str | None], options: RetrievalOptions) -> tuple[tuple[str, ...], ...]:
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


def within_class_folds(table: SignatureTable, options: RetrievalOptions) -> Iterator[Fold]:
    """The labelled shapes of each fold, with the within-class whitening of the other folds."""
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


def within_class_distances(table: SignatureTable, options: RetrievalOptions) -> Iterator[DistanceBlock]:
    """Distances from each labelled shape to the whole table, after the whitening of its fold."""
    logs = table_coordinates(table, options.distance)
    for queries, whitening in within_class_folds(table, options):
        yield from pairwise_blocks(options.distance, whitening.apply(logs), queries)


def within_class_subsets(table: SignatureTable, options: RetrievalOptions) -> Iterator[Subset]:
    """The shapes of each fold, and their distances after its whitening.

    Shapes of the fit are left out, because their classes are dense, since their labels were used, and would
    distort what re-ranking measures: neighbourhoods.
    """
    logs = table_coordinates(table, options.distance)
    for queries, whitening in within_class_folds(table, options):
        blocks = pairwise_blocks(options.distance, whitening.apply(logs[queries]), np.arange(len(queries)))
        yield Subset(queries, blocks)


def rank_subsets(
    subsets: Iterable[Subset],
    ids: Sequence[str],
    labels: Sequence[str | None],
    methods: Sequence[str],
    *,
    failed: Mapping[str, str | None] = NO_FAILURES,
) -> dict[str, Rankings]:
    """Rank each labelled shape's subset of a gallery, by plain lists ("none") and by those of each method.

    Shapes behind the list that is sorted again keep their ranks.
    """
    lists: list[tuple[Positions, NeighbourLists]] = []

    def plain_blocks() -> Iterator[SortedBlock]:
        for members, blocks in subsets:
            m = len(members)
            length = min(N_RERANKED + 1, m)  # with the shape itself
            kept = NeighbourLists(np.empty((m, length), dtype=np.intp), np.empty((m, length)))
            names = [ids[position] for position in members]
            for block in blocks:
                order = by_distance(block, names)
                nearest = order[:, :length]
                kept.order[block.queries] = nearest
                kept.distances[block.queries] = np.take_along_axis(block.distances, nearest, axis=1)
                yield SortedBlock(members[block.queries], members[order])
            lists.append((members, kept))

    plain = rank_sorted(plain_blocks(), ids, labels, failed=failed)
    rankings = {"none": plain}
    # Ranks behind the lists are as before. Lists that are shorter have all shapes of their subset.
    behind = plain.hit_rank > N_RERANKED
    labelled = np.array([label is not None for label in labels], dtype=bool)
    for method in (method for method in methods if method != "none"):
        again = (
            SortedBlock(members[queries], members[rerank(method, kept, queries)])
            for members, kept in lists
            for queries in [np.flatnonzero(labelled[members])]
        )
        first = rank_sorted(again, ids, labels, failed=failed)
        hit_query = np.concatenate([first.hit_query, plain.hit_query[behind]])
        hit_rank = np.concatenate([first.hit_rank, plain.hit_rank[behind]])
        order = np.lexsort((hit_rank, hit_query))
        rankings[method] = replace(first, hit_query=hit_query[order], hit_rank=hit_rank[order])
    return rankings


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
    if whitening is None:
        return options.whitening == "within-class"
    if whitening.kind == "within-class":
        whitening.check_made_for(table.digest)
    return whitening.kind == "within-class"


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
