"""Rankings of a gallery: where the shapes of a query's class came.

Shapes are ranked by distance, ties by id, the query itself left out. Who is a query, and what is relevant to
it, is said in `pcretrieve.evaluation.measures`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from pcretrieve.errors import BenchmarkError, InputError
from pcretrieve.retrieval import DistanceBlock, Positions, Ranking
from pcretrieve.types import FloatArray
from pcretrieve.values import Value

__all__ = ["Rankings", "rank", "rank_gallery"]


@dataclass(frozen=True, slots=True, eq=False)
class Rankings(Value):
    """Where each query's relevant shapes came: all that the measures depend on.

    Attributes
    ----------
    ids : tuple of (str or None), length Q
        The queries in order of the gallery, then one None for each failed shape.
    labels : tuple of str, length Q
    n_relevant : (Q,) intp
        R, at least 1.
    hit_query, hit_rank : (H,) intp
        One entry per relevant shape ranked: the query's number, ascending, and the rank, 1 for the nearest,
        ascending within each query.
    n_gallery : int
        Number of shapes in the gallery.
    n_failed : int
        Queries that failed.
    n_single : int
        Shapes alone in their class, which are no queries.
    """

    ids: tuple[str | None, ...]
    labels: tuple[str, ...]
    n_relevant: Positions
    hit_query: Positions
    hit_rank: Positions
    n_gallery: int
    n_failed: int
    n_single: int

    @property
    def n_ranked(self) -> int:
        """Length of each ranked list, which is the gallery without the query."""
        return max(0, self.n_gallery - 1)


def rank(
    ranking: Ranking, labels: Sequence[str | None], *, failed_labels: Iterable[str | None] = ()
) -> Rankings:
    """Rank a gallery for each labelled shape in it.

    Parameters
    ----------
    ranking : Ranking
        An index, a pairwise matcher or a distance matrix.
    labels : sequence of (str or None), length N
        Classes of the shapes `ranking.ids`.
    failed_labels : iterable of (str or None)
        Classes of the shapes that are not in the gallery because they failed; they count as misses.

    Returns
    -------
    Rankings
        The ranks of the relevant shapes.

    Raises
    ------
    BenchmarkError
        If no class has two shapes.
    InputError
        If the labels are not as many as the shapes.
    """
    labelled = np.flatnonzero([label is not None for label in labels])
    return rank_gallery(ranking.blocks(labelled), ranking.ids, labels, failed_labels=failed_labels)


def rank_gallery(
    blocks: Iterable[DistanceBlock],
    ids: Sequence[str],
    labels: Sequence[str | None],
    *,
    failed_labels: Iterable[str | None] = (),
) -> Rankings:
    """Rank the gallery for each labelled shape, and keep the ranks of the relevant ones.

    Parameters
    ----------
    blocks : iterable of DistanceBlock
        In any order. Each query must come in exactly one of them; shapes that are no queries may come too.
    ids : sequence of str, length N
        The gallery.
    labels : sequence of (str or None), length N
    failed_labels : iterable of (str or None)
        Classes of the shapes that have no signature, one entry each; None is ignored.

    Raises
    ------
    BenchmarkError
        Where no class has two shapes.
    InputError
        For distances that are negative, NaN or of the wrong shape, and queries that are missing or repeated.
    """
    if len(ids) != len(labels):
        raise InputError(f"labels must be as many as ids ({len(ids)}), got {len(labels)}")
    failed = [label for label in failed_labels if label is not None]
    sizes = Counter(label for label in (*labels, *failed) if label is not None)
    shared = {label for label, size in sizes.items() if size > 1}
    if not shared:
        raise BenchmarkError(
            f"retrieval measures need a class with at least 2 shapes, got {len(sizes)} classes and none so "
            "large; label more shapes"
        )
    answered = [position for position, label in enumerate(labels) if label in shared]
    missed = [label for label in failed if label in shared]

    code_of = {label: code for code, label in enumerate(sorted(sizes))}
    codes = np.array([-1 if label is None else code_of[label] for label in labels], dtype=np.intp)  # (N,)
    by_id = np.array(sorted(range(len(ids)), key=ids.__getitem__), dtype=np.intp)  # (N,)
    number = np.full(len(ids), -1)  # (N,) of each shape as a query
    number[answered] = np.arange(len(answered))
    hits = [np.empty((2, 0), dtype=np.intp)]
    times_seen = np.zeros(len(answered), dtype=np.intp)
    for block in blocks:
        _check_block(block, len(ids))
        wanted = np.flatnonzero(number[block.queries] >= 0)
        queries = block.queries[wanted]
        np.add.at(times_seen, number[queries], 1)
        row, rank = _relevant_ranks(block.distances[wanted], queries, by_id, codes)
        hits.append(np.stack([number[queries][row], rank]))
    if (times_seen != 1).any():
        raise InputError(
            f"every query must be ranked exactly once, got {(times_seen == 0).sum()} queries missing and "
            f"{(times_seen > 1).sum()} repeated"
        )
    hit_query, hit_rank = np.concatenate(hits, axis=1)
    order = np.lexsort((hit_rank, hit_query))
    query_labels = (*(str(labels[position]) for position in answered), *missed)
    return Rankings(
        ids=(*(ids[position] for position in answered), *(None for _ in missed)),
        labels=query_labels,
        n_relevant=np.array([sizes[label] - 1 for label in query_labels], dtype=np.intp),
        hit_query=hit_query[order],
        hit_rank=hit_rank[order],
        n_gallery=len(ids),
        n_failed=len(missed),
        n_single=sum(size for size in sizes.values() if size == 1),
    )


def _relevant_ranks(
    distances: FloatArray, queries: Positions, by_id: Positions, codes: Positions
) -> tuple[Positions, Positions]:
    """Row and rank of every shape that has the class of the row's query."""
    columns = distances[:, by_id]  # (q, N), so that a stable sort breaks ties by id
    # The query itself comes before all others, at rank 0.
    columns[queries[:, np.newaxis] == by_id] = -np.inf
    order = np.argsort(columns, axis=1, kind="stable")
    relevant = codes[by_id][order] == codes[queries][:, np.newaxis]
    relevant[:, :1] = False
    row, rank = np.nonzero(relevant)
    return row, rank


def _check_block(block: DistanceBlock, n: int) -> None:
    if block.distances.shape != (len(block.queries), n):
        raise InputError(
            f"distances must have shape ({len(block.queries)}, {n}), queries by gallery, "
            f"got {block.distances.shape}"
        )
    usable = block.distances >= 0
    if not usable.all():
        raise InputError(f"distances must be 0 or more, got {(~usable).sum()} that are negative or NaN")
