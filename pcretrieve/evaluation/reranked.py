"""Distances of a gallery → the rankings before and after re-ranking, from one pass over the distances."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pcretrieve.evaluation.rankings import NO_FAILURES, Rankings, SortedBlock, by_distance, rank_sorted
from pcretrieve.retrieval import N_RERANKED, DistanceBlock, NeighbourLists, Positions, rerank

__all__ = ["Subset", "rank_subsets"]


class Subset(NamedTuple):
    """Shapes of a gallery that are ranked among each other.

    members: (m,) intp, positions of the shapes in the gallery.
    """

    members: Positions
    blocks: Iterable[DistanceBlock]


def rank_subsets(
    subsets: Iterable[Subset],
    ids: Sequence[str],
    labels: Sequence[str | None],
    methods: Sequence[str],
    *,
    failed: Mapping[str, str | None] = NO_FAILURES,
) -> dict[str, Rankings]:
    """Rank each labelled shape's subset of a gallery, by plain and by re-ranked lists.

    Returns dict of str to Rankings: by the name of the method. Shapes behind the list that is sorted again
        keep their ranks.
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
    # Ranks behind the lists are as before. Lists that are shorter have all shapes of their subset.
    behind = plain.hit_rank > N_RERANKED
    labelled = np.array([label is not None for label in labels], dtype=bool)
    rankings = {}
    for method in methods:
        if method == "none":
            rankings[method] = plain
            continue
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
