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
from pcretrieve.values import FloatArray
from pcretrieve.values.base import Value

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
    genuine, impostor: (G,), (I,) float64, distances of pairs of shapes of one class, and of two classes,
        ascending; none after re-ranking.
    """

    ids: tuple[str, ...]
    labels: tuple[str, ...]
    n_relevant: Positions
    hit_query: Positions
    hit_rank: Positions
    genuine: FloatArray
    impostor: FloatArray
    nearest: tuple[str | None, ...]
    nearest_labels: tuple[str | None, ...]
    n_gallery: int
    n_failed: int
    n_single: int

    @property
    def n_ranked(self) -> int:
        """Length of each ranked list, which is the gallery without the query."""
        return max(0, self.n_gallery - 1)


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
            kept = NeighbourLists(np.empty((m, length), dtype=np.intp), np.empty((m, length)))
            names = [ids[position] for position in members]
            for block in blocks:
                order = _by_distance(block, names)
                nearest = order[:, :length]
                kept.order[block.queries] = nearest
                kept.distances[block.queries] = np.take_along_axis(block.distances, nearest, axis=1)
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
    genuine, impostor = (np.sort(np.concatenate([np.zeros(0), *found])) for found in pairs)
    plain = replace(plain, genuine=genuine, impostor=impostor)
    if not again:
        return plain, plain
    reranked = (
        (members[queries], members[rerank(kept, queries)])
        for members, kept in lists
        for queries in [np.flatnonzero(labelled[members])]
    )
    first = _rank_sorted(reranked, ids, labels, failed)
    # Ranks behind the lists are as before. Lists that are shorter have all shapes of their subset.
    behind = plain.hit_rank > N_RERANKED
    hit_query = np.concatenate([first.hit_query, plain.hit_query[behind]])
    hit_rank = np.concatenate([first.hit_rank, plain.hit_rank[behind]])
    order = np.lexsort((hit_rank, hit_query))
    return replace(first, hit_query=hit_query[order], hit_rank=hit_rank[order]), plain


def _by_distance(block: DistanceBlock, ids: Sequence[str]) -> Positions:
    """Sort a gallery by its distances from some queries.

    Returns (q, N) intp: positions: first the query itself, then the nearest shapes, equal distances by id.
    """
    by_id = np.array(sorted(range(len(ids)), key=ids.__getitem__), dtype=np.intp)  # (N,)
    columns = block.distances[
        :, by_id
    ]  # (q, N): a stable sort then orders equal distances by identifier
    columns[block.queries[:, np.newaxis] == by_id] = -np.inf
    return np.asarray(by_id[np.argsort(columns, axis=1, kind="stable")])


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
        genuine=np.zeros(0),
        impostor=np.zeros(0),
        nearest=(*(None if near < 0 else ids[near] for near in nearest), *(None for _ in missed)),
        nearest_labels=(
            *(None if near < 0 else labels[near] for near in nearest),
            *(None for _ in missed),
        ),
        n_gallery=len(ids),
        n_failed=len(missed),
        n_single=sum(size for size in sizes.values() if size == 1),
    )
