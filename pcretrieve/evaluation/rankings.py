"""Distances → the ranks of the relevant shapes of each query.

For each query the gallery without the query is ranked by distance, equal distances by identifier. Which
shapes are queries, and which are relevant to a query, is defined in `pcretrieve.evaluation.measures`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from pcretrieve.errors import BenchmarkError
from pcretrieve.retrieval import DistanceBlock, Positions
from pcretrieve.retrieval.reranking import N_RERANKED, NeighbourLists, rerank
from pcretrieve.values.base import Value

#: The classes of failed shapes by id, if no shape failed.
NO_FAILURES: Mapping[str, str | None] = MappingProxyType({})


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
    """

    ids: tuple[str, ...]
    labels: tuple[str, ...]
    n_relevant: Positions
    hit_query: Positions
    hit_rank: Positions
    nearest: tuple[str | None, ...]
    nearest_labels: tuple[str | None, ...]
    n_gallery: int
    n_failed: int
    n_single: int

    @property
    def n_ranked(self) -> int:
        """Length of each ranked list, which is the gallery without the query."""
        return max(0, self.n_gallery - 1)


def rank_gallery(
    blocks: Iterable[DistanceBlock],
    ids: Sequence[str],
    labels: Sequence[str | None],
    *,
    failed: Mapping[str, str | None] = NO_FAILURES,
) -> Rankings:
    """Rank a gallery for each labelled shape by blocks of distances."""
    return rank_subsets([Subset(np.arange(len(ids)), blocks)], ids, labels, failed=failed)["none"]


def rank_subsets(
    subsets: Iterable[Subset],
    ids: Sequence[str],
    labels: Sequence[str | None],
    methods: Sequence[str] = ("none",),
    *,
    failed: Mapping[str, str | None] = NO_FAILURES,
) -> dict[str, Rankings]:
    """Rank each labelled shape's subset of a gallery, by plain lists ("none") and by those of each method.

    Shapes behind the list that is sorted again keep their ranks.
    """
    again = [method for method in methods if method != "none"]
    lists: list[tuple[Positions, NeighbourLists]] = []

    def plain_blocks() -> Iterator[tuple[Positions, Positions]]:
        for members, blocks in subsets:
            m = len(members)
            length = min(N_RERANKED + 1, m) if again else 0  # with the shape itself
            kept = NeighbourLists(np.empty((m, length), dtype=np.intp), np.empty((m, length)))
            names = [ids[position] for position in members]
            for block in blocks:
                order = _by_distance(block, names)
                nearest = order[:, :length]
                kept.order[block.queries] = nearest
                kept.distances[block.queries] = np.take_along_axis(block.distances, nearest, axis=1)
                yield members[block.queries], members[order]
            lists.append((members, kept))

    plain = _rank_sorted(plain_blocks(), ids, labels, failed)
    rankings = {"none": plain}
    # Ranks behind the lists are as before. Lists that are shorter have all shapes of their subset.
    behind = plain.hit_rank > N_RERANKED
    labelled = np.array([label is not None for label in labels], dtype=bool)
    for method in again:
        blocks = (
            (members[queries], members[rerank(method, kept, queries)])
            for members, kept in lists
            for queries in [np.flatnonzero(labelled[members])]
        )
        first = _rank_sorted(blocks, ids, labels, failed)
        hit_query = np.concatenate([first.hit_query, plain.hit_query[behind]])
        hit_rank = np.concatenate([first.hit_rank, plain.hit_rank[behind]])
        order = np.lexsort((hit_rank, hit_query))
        rankings[method] = replace(first, hit_query=hit_query[order], hit_rank=hit_rank[order])
    return rankings


def _by_distance(block: DistanceBlock, ids: Sequence[str]) -> Positions:
    """Sort a gallery by its distances from some queries.

    Returns (q, N) intp: positions: first the query itself, then the nearest shapes, equal distances by id.
    """
    by_id = np.array(sorted(range(len(ids)), key=ids.__getitem__), dtype=np.intp)  # (N,)
    columns = block.distances[:, by_id]  # (q, N): a stable sort then orders equal distances by identifier
    columns[block.queries[:, np.newaxis] == by_id] = -np.inf
    order: Positions = by_id[np.argsort(columns, axis=1, kind="stable")]
    return order


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
    missed = {shape_id: label for shape_id, label in failed.items() if label is not None and label in shared}

    code_of = {label: code for code, label in enumerate(sorted(sizes))}
    codes = np.array([-1 if label is None else code_of[label] for label in labels], dtype=np.intp)  # (N,)
    number = np.full(len(ids), -1)  # (N,) of each shape as a query
    number[answered] = np.arange(len(answered))
    hits = [np.empty((2, 0), dtype=np.intp)]
    nearest = np.full(len(answered), -1)
    for asked, order in blocks:
        wanted = np.flatnonzero(number[asked] >= 0)
        queries = asked[wanted]
        relevant = codes[order[wanted]] == codes[queries][:, np.newaxis]
        relevant[:, :1] = False  # the query itself, at rank 0
        row, rank = np.nonzero(relevant)
        hits.append(np.stack([number[queries][row], rank]))
        if order.shape[1] > 1:
            nearest[number[queries]] = order[wanted, 1]
    hit_query, hit_rank = np.concatenate(hits, axis=1)
    order = np.lexsort((hit_rank, hit_query))
    query_labels = (*(str(labels[position]) for position in answered), *missed.values())
    return Rankings(
        ids=(*(ids[position] for position in answered), *missed),
        labels=query_labels,
        n_relevant=np.array([sizes[label] - 1 for label in query_labels], dtype=np.intp),
        hit_query=hit_query[order],
        hit_rank=hit_rank[order],
        nearest=(*(None if near < 0 else ids[near] for near in nearest), *(None for _ in missed)),
        nearest_labels=(*(None if near < 0 else labels[near] for near in nearest), *(None for _ in missed)),
        n_gallery=len(ids),
        n_failed=len(missed),
        n_single=sum(size for size in sizes.values() if size == 1),
    )
