"""Distances → the ranks of the relevant shapes of each query.

For each query the gallery without the query is ranked by distance, equal distances by identifier. Which
shapes are queries, and which are relevant to a query, is defined in `pcretrieve.evaluation.measures`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from pcretrieve.errors import BenchmarkError, InputError
from pcretrieve.retrieval import DistanceBlock, Positions, Ranking
from pcretrieve.values.base import Value

#: The classes of failed shapes by id, if no shape failed.
NO_FAILURES: Mapping[str, str | None] = MappingProxyType({})


class SortedBlock(NamedTuple):
    """Some queries, and the gallery in the order of its distances from each of them.

    queries: (q,) intp, positions of the queries in the gallery.
    order: (q, m) intp, positions of the shapes that are ranked: first the query itself, then the nearest.
    """

    queries: Positions
    order: Positions


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


def rank(
    ranking: Ranking, labels: Sequence[str | None], *, failed: Mapping[str, str | None] = NO_FAILURES
) -> Rankings:
    """Rank a gallery for each labelled shape in it."""
    labelled = np.flatnonzero([label is not None for label in labels])
    return rank_gallery(ranking.blocks(labelled), ranking.ids, labels, failed=failed)


def rank_gallery(
    blocks: Iterable[DistanceBlock],
    ids: Sequence[str],
    labels: Sequence[str | None],
    *,
    failed: Mapping[str, str | None] = NO_FAILURES,
) -> Rankings:
    """Rank a gallery for each labelled shape by blocks of distances."""
    in_order = (SortedBlock(block.queries, by_distance(block, ids)) for block in blocks)
    return rank_sorted(in_order, ids, labels, failed=failed)


def by_distance(block: DistanceBlock, ids: Sequence[str]) -> Positions:
    """Sort a gallery by its distances from some queries.

    Returns (q, N) intp: positions: first the query itself, then the nearest shapes, equal distances by id.
    """
    _check_block(block, len(ids))
    by_id = np.array(sorted(range(len(ids)), key=ids.__getitem__), dtype=np.intp)  # (N,)
    columns = block.distances[:, by_id]  # (q, N): a stable sort then orders equal distances by identifier
    columns[block.queries[:, np.newaxis] == by_id] = -np.inf
    order: Positions = by_id[np.argsort(columns, axis=1, kind="stable")]
    return order


def rank_sorted(
    blocks: Iterable[SortedBlock],
    ids: Sequence[str],
    labels: Sequence[str | None],
    *,
    failed: Mapping[str, str | None] = NO_FAILURES,
) -> Rankings:
    """The ranks of the relevant shapes in a gallery that is sorted for each query."""
    if len(ids) != len(labels):
        raise InputError(f"labels must be as many as ids ({len(ids)}), got {len(labels)}")
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
    times_seen = np.zeros(len(answered), dtype=np.intp)
    nearest = np.full(len(answered), -1)
    for block in blocks:
        wanted = np.flatnonzero(number[block.queries] >= 0)
        queries = block.queries[wanted]
        np.add.at(times_seen, number[queries], 1)
        relevant = codes[block.order[wanted]] == codes[queries][:, np.newaxis]
        relevant[:, :1] = False  # the query itself, at rank 0
        row, rank = np.nonzero(relevant)
        hits.append(np.stack([number[queries][row], rank]))
        if block.order.shape[1] > 1:
            nearest[number[queries]] = block.order[wanted, 1]
    if (times_seen != 1).any():
        raise InputError(
            f"every query must be ranked exactly once, got {(times_seen == 0).sum()} queries missing and "
            f"{(times_seen > 1).sum()} repeated"
        )
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


def _check_block(block: DistanceBlock, n: int) -> None:
    if block.distances.shape != (len(block.queries), n):
        raise InputError(
            f"distances must have shape ({len(block.queries)}, {n}), queries by gallery, "
            f"got {block.distances.shape}"
        )
    usable = block.distances >= 0
    if not usable.all():
        raise InputError(f"distances must be 0 or more, got {(~usable).sum()} that are negative or NaN")
