"""Distances of a gallery → ranks after re-ranking, as distances."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import numpy as np

from pcretrieve.retrieval import DistanceBlock, Positions, neighbour_lists, rerank

__all__ = ["reranked_blocks"]

# Number of ranks that are in memory at once, as in `pcretrieve.retrieval.BLOCK_DISTANCES`.
BLOCK_ROWS = 256


def reranked_blocks(
    method: str, blocks: Callable[[], Iterable[DistanceBlock]], n: int, queries: Positions
) -> Iterator[DistanceBlock]:
    """The ranks of a gallery for some queries, after re-ranking.

    Parameters
    ----------
    method : str
        A name in `pcretrieve.retrieval.RERANKINGS`.
    blocks : function that returns an iterable of DistanceBlock
        All distances of the gallery; it is called twice.
    n : int
        Number of shapes of the gallery.
    queries : (Q,) intp
        Positions of the queries in the gallery.

    Yields
    ------
    DistanceBlock
        For each query the rank of each shape in place of its distance: 0 for the query itself. Shapes behind
        the list that is sorted again are in the order of their distances.
    """
    lists = neighbour_lists(blocks(), n)
    # Once for all queries, because the neighbourhoods of the whole gallery are computed each time.
    sorted_again = rerank(method, lists, queries)  # (Q, K)
    place = np.full(n, -1)
    place[queries] = np.arange(len(queries))
    for rows, distances in blocks():
        kept = np.flatnonzero(place[rows] >= 0)
        for start in range(0, len(kept), BLOCK_ROWS):
            chosen = kept[start : start + BLOCK_ROWS]
            first = sorted_again[place[rows[chosen]]]  # (q, K)
            ranks = np.argsort(np.argsort(distances[chosen], axis=1, kind="stable"), axis=1).astype(
                np.float64
            )
            ranks += first.shape[1]  # behind the list
            np.put_along_axis(ranks, first, np.arange(float(first.shape[1]))[np.newaxis], axis=1)
            yield DistanceBlock(rows[chosen], ranks)
