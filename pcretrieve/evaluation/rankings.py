"""Catalogue, table or distances → the ranks of the relevant shapes of each query.

For each query the gallery without the query is ranked by distance, equal distances by identifier. Which
shapes are queries, and which are relevant to a query, is defined in `pcretrieve.evaluation.measures`.

A within-class whitening is fitted to labels. To keep training and test classes apart, the classes are then
assigned to folds; the queries of a fold are ranked against the whole gallery after the whitening that is
fitted to the shapes of the other folds (grouped cross-validation). The measures tend to be lower than for a
gallery of new shapes: the shapes of the fit, all of which are irrelevant to the query, have smaller distances
after a whitening that was fitted to them.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pcretrieve.catalogue import Catalogue, CatalogueLike
from pcretrieve.errors import BenchmarkError, InputError
from pcretrieve.gallery.fitted import calibrated, signatures
from pcretrieve.ingestion.labels import labels_of, match_labels
from pcretrieve.options import OptionsLike, PipelineOptions, RerankKind, RetrievalOptions
from pcretrieve.retrieval import (
    DistanceBlock,
    DistanceMatrix,
    Positions,
    SignatureIndex,
    Whitening,
    fit_whitening,
    people,
    table_whitening,
)
from pcretrieve.retrieval.distances import pairwise_blocks, table_coordinates
from pcretrieve.retrieval.reranking import N_RERANKED, NeighbourLists, rerank
from pcretrieve.values import FloatArray, SignatureTable
from pcretrieve.values.base import Value, numbers

logger = logging.getLogger(__name__)

#: The classes of failed shapes by id, if no shape failed.
NO_FAILURES: Mapping[str, str | None] = MappingProxyType({})

# Number of shapes, drawn at random, whose pairs with all shapes are kept: 160 MB among 10,000 shapes.
N_PAIRED = 2000


class Subset(NamedTuple):
    """Shapes of a gallery that are ranked among each other, and their distances.

    members: (m,) intp, positions of the shapes in the gallery.
    """

    members: Positions
    blocks: Iterable[DistanceBlock]


@dataclass(frozen=True, slots=True, eq=False)
class Rankings(Value):
    """The ranks of the relevant shapes of each query, which is all that retrieval measures depend on.

    n_relevant: (Q,) intp, r, the number of relevant shapes of each query, at least 1. Failed shapes are
        included.
    hit_query, hit_rank: (H,) intp, one entry for each relevant shape in a ranked list: the number of the
        query, ascending, and the rank of the shape, 1 for the nearest, ascending for each query.
    n_nearer: (Q,) intp, number of other classes of which a shape is nearer than any relevant shape; all
        n_classes − 1 where no relevant shape is ranked.
    genuine, impostor: (G,), (I,) float64, distances of pairs of shapes of one class, and of two classes,
        ascending; none after re-ranking.
    """

    ids: tuple[str, ...]
    labels: tuple[str, ...]
    n_relevant: Positions
    hit_query: Positions
    hit_rank: Positions
    n_nearer: Positions
    genuine: FloatArray
    impostor: FloatArray
    nearest: tuple[str | None, ...]
    nearest_labels: tuple[str | None, ...]
    n_gallery: int
    n_classes: int
    n_failed: int
    n_single: int

    @property
    def n_ranked(self) -> int:
        """Length of each ranked list, which is the gallery without the query."""
        return max(0, self.n_gallery - 1)

    def of_queries(self, asked: Set[str]) -> Rankings:
        """The same rankings, of some of the queries only; the gallery stays whole."""
        kept = np.array([shape_id in asked for shape_id in self.ids], dtype=bool)
        hits = kept[self.hit_query]
        numbers = np.cumsum(kept) - 1
        return replace(
            self,
            ids=tuple(compress(self.ids, kept)),
            labels=tuple(compress(self.labels, kept)),
            n_relevant=self.n_relevant[kept],
            hit_query=numbers[self.hit_query[hits]],
            hit_rank=self.hit_rank[hits],
            n_nearer=self.n_nearer[kept],
            nearest=tuple(compress(self.nearest, kept)),
            nearest_labels=tuple(compress(self.nearest_labels, kept)),
        )


def rank_subsets(
    subsets: Iterable[Subset],
    ids: Sequence[str],
    labels: Sequence[str | None],
    *,
    again: bool = False,
    failed: Mapping[str, str | None] = NO_FAILURES,
) -> tuple[Rankings, Rankings]:
    """Rank each labelled shape's subset of a gallery, re-ranked if so asked, and by distance alone.

    Shapes behind the list that is sorted again keep their ranks.
    """
    lists: list[tuple[Positions, NeighbourLists]] = []
    codes = np.unique([label or "" for label in labels], return_inverse=True)[1]
    labelled = np.array([label is not None for label in labels], dtype=bool)
    paired = labelled & (np.random.default_rng(0).permutation(len(ids)) < N_PAIRED)
    pairs: tuple[list[FloatArray], list[FloatArray]] = ([], [])

    def plain_blocks() -> Iterator[tuple[Positions, Positions]]:
        for members, blocks in subsets:
            m = len(members)
            length = min(N_RERANKED + 1, m) if again else 0  # with the shape itself
            kept = NeighbourLists(
                np.empty((m, length), dtype=np.intp), np.empty((m, length))
            )
            names = [ids[position] for position in members]
            for block in blocks:
                order = _by_distance(block, names)
                nearest = order[:, :length]
                kept.order[block.queries] = nearest
                kept.distances[block.queries] = np.take_along_axis(
                    block.distances, nearest, axis=1
                )
                asked = members[block.queries]
                some = paired[asked]
                one = asked[some, np.newaxis]
                is_pair, is_same = (
                    labelled[members] & (members != one),
                    codes[members] == codes[one],
                )
                for found, kind in zip(pairs, (is_same, ~is_same), strict=True):
                    found.append(block.distances[some][is_pair & kind])
                yield asked, members[order]
            lists.append((members, kept))

    plain = _rank_sorted(plain_blocks(), ids, labels, failed)
    genuine, impostor = (
        np.sort(np.concatenate([np.zeros(0), *found])) for found in pairs
    )
    plain = replace(plain, genuine=genuine, impostor=impostor)
    if not again:
        return plain, plain
    reranked = (
        (members[queries], members[rerank(kept, queries)])
        for members, kept in lists
        for queries in [np.flatnonzero(labelled[members])]
    )
    return _continued(_rank_sorted(reranked, ids, labels, failed), plain), plain


def _continued(first: Rankings, plain: Rankings) -> Rankings:
    """Rankings of lists that were sorted again, and behind them those by distance."""
    # Ranks behind the lists are as before. Lists that are shorter have all shapes of their subset.
    behind = plain.hit_rank > N_RERANKED
    hit_query = np.concatenate([first.hit_query, plain.hit_query[behind]])
    hit_rank = np.concatenate([first.hit_rank, plain.hit_rank[behind]])
    order = np.lexsort((hit_rank, hit_query))
    is_there = np.isin(np.arange(len(first.ids)), first.hit_query)
    return replace(
        first,
        hit_query=hit_query[order],
        hit_rank=hit_rank[order],
        n_nearer=np.where(is_there, first.n_nearer, plain.n_nearer),
    )


def _by_distance(block: DistanceBlock, ids: Sequence[str]) -> Positions:
    """Sort a gallery by its distances from some queries.

    Returns (q, N) intp: positions: first the query itself, then the nearest shapes, equal distances by id.
    """
    by_id = np.array(sorted(range(len(ids)), key=ids.__getitem__), dtype=np.intp)  # (N,)
    # (q, N): a stable sort then orders equal distances by identifier.
    columns = block.distances[:, by_id]
    columns[block.queries[:, np.newaxis] == by_id] = -np.inf
    return by_id[np.argsort(columns, axis=1, kind="stable")]


def _rank_sorted(
    blocks: Iterable[tuple[Positions, Positions]],
    ids: Sequence[str],
    labels: Sequence[str | None],
    failed: Mapping[str, str | None],
) -> Rankings:
    """The ranks of the relevant shapes in a gallery that is sorted for each query.

    blocks: positions of some queries (q,), and of the shapes that are ranked for each (q, m): first the query
        itself, then the nearest.
    """
    sizes = Counter(label for label in (*labels, *failed.values()) if label is not None)
    shared = {label for label, size in sizes.items() if size > 1}
    if not shared:
        raise BenchmarkError(
            f"retrieval measures need a class with at least 2 shapes, got {len(sizes)} classes and none so "
            "large; label more shapes"
        )
    answered = [position for position, label in enumerate(labels) if label in shared]
    missed = {
        shape_id: label
        for shape_id, label in failed.items()
        if label is not None and label in shared
    }

    code_of = {label: code for code, label in enumerate(sorted(sizes))}
    codes = np.array(
        [-1 if label is None else code_of[label] for label in labels], dtype=np.intp
    )  # (N,)
    hit_query, hit_rank, n_nearer, nearest = _hits(blocks, codes, answered)
    query_labels = (*(str(labels[position]) for position in answered), *missed.values())
    return Rankings(
        ids=(*(ids[position] for position in answered), *missed),
        labels=query_labels,
        n_relevant=np.array([sizes[label] - 1 for label in query_labels], dtype=np.intp),
        hit_query=hit_query,
        hit_rank=hit_rank,
        n_nearer=np.append(
            np.where(n_nearer < 0, len(sizes) - 1, n_nearer),
            np.full(len(missed), len(sizes) - 1),
        ),
        genuine=np.zeros(0),
        impostor=np.zeros(0),
        nearest=(
            *(None if near < 0 else ids[near] for near in nearest),
            *(None for _ in missed),
        ),
        nearest_labels=(
            *(None if near < 0 else labels[near] for near in nearest),
            *(None for _ in missed),
        ),
        n_gallery=len(ids),
        n_classes=len(sizes),
        n_failed=len(missed),
        n_single=sum(size for size in sizes.values() if size == 1),
    )


def _hits(
    blocks: Iterable[tuple[Positions, Positions]],
    codes: Positions,
    answered: Sequence[int],
) -> tuple[Positions, Positions, Positions, Positions]:
    """The query and the rank of each relevant shape, and of each query what is nearest.

    codes: (N,) classes of the shapes, −1 for none. answered: their positions that are queries.
    Returns, after the queries and the ranks, (Q,) the number of other classes that are nearer than the own
    one, and (Q,) the nearest shape; −1 where nothing relevant, and nothing at all, is ranked.
    """
    number = np.full(len(codes), -1)  # (N,) of each shape as a query
    number[answered] = np.arange(len(answered))
    hits = [np.empty((2, 0), dtype=np.intp)]
    n_nearer, nearest = np.full((2, len(answered)), -1)
    for asked, order in blocks:
        wanted = np.flatnonzero(number[asked] >= 0)
        queries = asked[wanted]
        relevant = codes[order[wanted]] == codes[queries][:, np.newaxis]
        relevant[:, :1] = False  # the query itself, at rank 0
        row, rank = np.nonzero(relevant)
        hits.append(np.stack([number[queries][row], rank]))
        found, first = np.unique(row, return_index=True)
        n_nearer[number[queries[found]]] = [
            _n_classes(codes[order[wanted[one], 1:end]])
            for one, end in zip(found, rank[first], strict=True)
        ]
        if order.shape[1] > 1:
            nearest[number[queries]] = order[wanted, 1]
    hit_query, hit_rank = np.concatenate(hits, axis=1)
    by_query = np.lexsort((hit_rank, hit_query))
    return hit_query[by_query], hit_rank[by_query], n_nearer, nearest


def _n_classes(codes: Positions) -> int:
    """The number of classes of some shapes; codes below 0 are none."""
    return len(np.unique(codes[codes >= 0])) if len(codes) else 0


# --- grouped folds --------------------------------------------------------------------------------


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
            one_unit=table.has_one_unit,
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
            members,
            pairwise_blocks(options.distance, whitening.apply(logs[members]), rows),
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


# --- what is ranked: a catalogue, a table or distances ------------------------------------------------------


class RankedShapes(NamedTuple):
    """The rankings of some shapes; `plain` without re-ranking.

    n_left_out: number of queries that were left out because their scans are not good.
    """

    rankings: Rankings
    plain: Rankings
    table: SignatureTable | None = None
    whitening: str = ""
    n_left_out: int = 0


def rank_shapes(
    shapes: CatalogueLike | SignatureTable | DistanceMatrix | ArrayLike,
    options: OptionsLike = None,
    labels: str | Path | Iterable[object] | None = None,
    *,
    matrix: DistanceMatrix | None = None,
    good_only: bool = False,
) -> RankedShapes:
    """Rank shapes for each labelled shape among them."""
    if isinstance(shapes, SignatureTable):
        return RankedShapes(
            *rank_table(shapes, PipelineOptions.of(options).retrieval), table=shapes
        )
    if not isinstance(shapes, (str, Path, Catalogue)):
        distances = shapes if isinstance(shapes, DistanceMatrix) else _numbered(shapes)
        classes = _classes_of_rows(distances, labels)
        return _of_matrix(
            distances, classes, {}, PipelineOptions.of(options).retrieval.rerank
        )
    if not isinstance(labels, (str, Path, type(None))):
        raise InputError(
            "labels of a catalogue must be a label file or a layout, not a list"
        )
    with Catalogue.opened(shapes) as store:
        chosen = PipelineOptions.of(options, store.options)
        ranked = _of_catalogue(store, chosen, labels, matrix)
        if not good_only:
            return ranked
        good = {record.id for record in store.records() if not record.is_incomplete}
        asked = ranked.rankings.of_queries(good)
        if not asked.ids:
            raise BenchmarkError(f"no labelled scan in {store.location} is good")
        return ranked._replace(
            rankings=asked,
            plain=ranked.plain.of_queries(good),
            n_left_out=len(ranked.rankings.ids) - len(asked.ids),
        )


def _of_catalogue(
    catalogue: Catalogue,
    options: PipelineOptions,
    labels: str | Path | None,
    matrix: DistanceMatrix | None,
) -> RankedShapes:
    records = {record.id: record for record in catalogue.records()}
    if labels is None:
        classes = {shape_id: record.label for shape_id, record in records.items()}
    else:
        paths = {shape_id: record.path for shape_id, record in records.items()}
        classes = _classes(labels, labels_of(labels, paths.values()), paths)
    if not any(classes.values()):
        advice = "give --labels, a file of classes or a layout"
        if labels is not None:
            advice = f"no name in {labels} fits one"
        raise BenchmarkError(f"no shape in {catalogue.location} has a class: {advice}")
    if matrix is not None:
        check_known(matrix, catalogue)
        ranked_ids = set(matrix.ids)
        missing = {
            shape_id: classes[shape_id]
            for shape_id in records
            if shape_id not in ranked_ids
        }
        return _of_matrix(matrix, classes, missing, options.retrieval.rerank)
    table = signatures(catalogue, options=options)
    table = replace(table, labels=tuple(classes[shape_id] for shape_id in table.ids))
    failed = {
        record.id: classes[record.id]
        for record in records.values()
        if record.status == "failed"
    }
    retrieval = options.retrieval.without_labels
    whitening = None
    if retrieval.whitening == "within-class" and retrieval.calibration is None:
        reason = f"within-class, fitted for each of {retrieval.n_folds} folds of classes to the other folds"
        if retrieval.rerank != "none":
            reason += ", and the gallery is the fold"
    else:
        whitening = calibrated(options) or table_whitening(
            table, retrieval, people=people(options.signature)
        )
        reason = whitening.reason
        if options.retrieval.whitening == "auto" and whitening.kind in (
            "none",
            "neighbours",
        ):
            reason += ", without labels"
    rankings = rank_table(table, retrieval, whitening=whitening, failed=failed)
    return RankedShapes(*rankings, table, reason)


def check_known(matrix: DistanceMatrix, catalogue: Catalogue) -> None:
    """Check that a catalogue holds all shapes of a distance matrix."""
    if unknown := sorted({*matrix.ids} - catalogue.labels().keys()):
        raise InputError(
            f"a distance matrix must be of shapes in {catalogue.location}, got {len(unknown)} others, such "
            f"as {unknown[0]!r}: make it again with pcretrieve.matrix, or correct its ids"
        )


def _of_matrix(
    matrix: DistanceMatrix,
    classes: Mapping[str, str | None],
    missing: Mapping[str, str | None],
    rerank: RerankKind,
) -> RankedShapes:
    """The rankings by a matrix, in which some shapes are missing."""
    labels = [classes[shape_id] for shape_id in matrix.ids]
    again = rerank != "none"
    if again and not np.isfinite(matrix.values).all():
        raise InputError(
            f"re-ranking needs finite distances, got {np.isinf(matrix.values).sum()} that are infinite: "
            "rank without it"
        )
    everything = Subset(
        np.arange(len(matrix)), [DistanceBlock(np.arange(len(matrix)), matrix.values)]
    )
    return RankedShapes(
        *rank_subsets([everything], matrix.ids, labels, again=again, failed=missing)
    )


def _numbered(distances: ArrayLike) -> DistanceMatrix:
    """A plain array of distances, whose ids are the numbers of its rows, in their order."""
    rows = numbers("distances", distances)
    width = len(str(len(rows)))
    return DistanceMatrix(tuple(f"{row:0{width}}" for row in range(len(rows))), rows)


def _classes_of_rows(
    distances: DistanceMatrix, labels: str | Path | Iterable[object] | None
) -> Mapping[str, str | None]:
    """The classes of the rows of distances: those that are given, or those that they have."""
    if isinstance(labels, (str, Path)):
        return _classes_of_ids(labels, set(distances.ids))
    if labels is not None:
        given = tuple(None if label is None else str(label) for label in labels)
        distances = replace(distances, labels=given)
    classes = dict(zip(distances.ids, distances.labels, strict=True))
    if not any(classes.values()):
        raise BenchmarkError(
            "no row of the distances has a class: give labels, one for each row"
        )
    return classes


def _classes_of_ids(file: str | Path, ids: Set[str]) -> dict[str, str | None]:
    """The classes of shapes by the labels in a file, which names ids or files."""
    named: dict[str, str] = {}
    for name, label in labels_of(
        file, (f"/{shape_id}" for shape_id in sorted(ids))
    ).items():
        shape_id = name if name in ids else Path(name).stem
        if named.setdefault(shape_id if shape_id in ids else name, label) != label:
            raise BenchmarkError(
                f"a shape must have one class, {shape_id!r} has {named[shape_id]!r} and {label!r} in {file}"
            )
    return _classes(file, named, {shape_id: f"/{shape_id}" for shape_id in ids})


def _classes(
    file: str | Path, labels: Mapping[str, str], paths: Mapping[str, str]
) -> dict[str, str | None]:
    """The classes of shapes by the labels in a file; names in it that fit no shape are logged."""
    matched, unknown = match_labels(labels, paths)
    if unknown:
        logger.warning(
            "%s names %d shapes that are not among those ranked, such as %s",
            file,
            len(unknown),
            unknown[0],
        )
    return {shape_id: matched.get(shape_id) for shape_id in paths}
