"""Pairs of shapes that are probably of one class, found without labels.

Two shapes form a pair if each is among the other's k nearest after k-reciprocal re-ranking. The weight of a
pair has two factors. The squared Jaccard index of the two neighbourhoods is small for pairs between classes,
which share few neighbours. The inverse squared length of the difference makes all differences unit vectors
(spatial-sign covariance [1]_), so that a few distant pairs do not dominate the covariance.

References
----------
.. [1] Visuri, Koivunen and Oja, "Sign and rank covariance matrices", Journal of Statistical Planning and
   Inference 2000.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from pcretrieve.retrieval.distances import BLOCK_DISTANCES, DistanceBlock, Positions
from pcretrieve.retrieval.reranking import nearest_matrix, neighbour_lists, rerank
from pcretrieve.values import FloatArray

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Largest number k of neighbours that is tried, and k where no number stands out: the neighbourhoods of an
# isolated class of c shapes are equal for k = c − 1.
MOST_NEIGHBORS = 12
N_NEIGHBORS = 5

# k₁, k₂ and λ of the re-ranking: smaller sets than for a query, because a wrong pair does more harm than a
# missing one. See docs/decisions.md, K_RECIPROCAL.
PAIRING = (8, 3, 0.3)

# Mean Jaccard index of neighbouring neighbourhoods from which a number of neighbours stands out.
DISTINCT = 0.8

# Of more shapes than this, pairs are searched within groups of near shapes, so that the classes in the sample
# are complete, unlike those in a random sample.
LARGEST = 4000
N_GROUPS = 40
SEEDS_AT_ONCE = 5
SEED = 0

# Differences are no shorter than this share of the longest one, so that copies of one shape weigh no more
# than other pairs.
SHORTEST = 1e-4


class NeighbourPairs(NamedTuple):
    """Pairs of near shapes by their positions (P,), with weights (P,) for their squared differences."""

    first: Positions
    second: Positions
    weights: FloatArray
    n_neighbors: int


def neighbour_pairs(logs: FloatArray, n_neighbors: int | Literal["auto"] = "auto") -> NeighbourPairs:
    """The pairs of shapes, given as log-signatures (N, L), that are among each other's nearest."""
    from scipy.sparse import triu

    rows = np.arange(len(logs)) if len(logs) <= LARGEST else near_groups(logs, LARGEST)
    rows = rows[np.lexsort(logs[rows].T)]  # so that ties do not depend on the order of the table
    points = np.ascontiguousarray(logs[rows])
    lists = neighbour_lists(_blocks(points), len(points))
    order = rerank("k-reciprocal", lists, parameters=PAIRING)
    most = min(MOST_NEIGHBORS, order.shape[1] - 1)
    k = min(_distinct_number(order, most) if n_neighbors == "auto" else n_neighbors, order.shape[1] - 1)
    near = nearest_matrix(order, k)
    overlap = triu(_jaccard(near).multiply(near.T), k=1).tocoo()
    lengths = np.linalg.norm(points[overlap.row] - points[overlap.col], axis=1)
    kept = lengths > 0
    lengths = np.maximum(lengths[kept], SHORTEST * lengths.max(initial=0))
    weights = overlap.data[kept] ** 2 / lengths**2
    return NeighbourPairs(rows[overlap.row[kept]], rows[overlap.col[kept]], weights, k)


def _jaccard(near: csr_array) -> csr_array:
    """For each edge of a graph of neighbours, the Jaccard index of the neighbourhoods of its ends."""
    from scipy.sparse import csr_array

    size = near.indptr[1] - near.indptr[0]
    common = csr_array((near @ near.T).multiply(near))
    common.data = common.data / (2 * size - common.data)
    return common


def _distinct_number(order: Positions, most: int) -> int:
    """The number of neighbours at which the neighbourhoods of neighbours overlap most; else N_NEIGHBORS."""
    n = len(order)
    # Without the edges from each shape to itself, whose Jaccard index is 1.
    means = [(_jaccard(nearest_matrix(order, k)).sum() - n) / (n * k) for k in range(1, most + 1)]
    best = int(np.argmax(means)) + 1 if means else 0
    return best if means and means[best - 1] >= DISTINCT else N_NEIGHBORS


def _blocks(points: FloatArray) -> Iterator[DistanceBlock]:
    """Euclidean distances by matrix products: faster than `pairwise`, and exact enough for pairs."""
    points = points - points.mean(axis=0)
    squares = np.einsum("ij,ij->i", points, points)  # (N,)
    step = max(1, BLOCK_DISTANCES // max(1, len(points)))
    for start in range(0, len(points), step):
        rows = np.arange(start, min(start + step, len(points)))
        gaps = squares[rows, np.newaxis] + squares - 2 * (points[rows] @ points.T)
        yield DistanceBlock(rows, np.sqrt(np.maximum(gaps, 0)))


def near_groups(logs: FloatArray, largest: int) -> Positions:
    """The rows (n,), ascending, of the log-signatures (N, L) nearest to a few that are chosen at random."""
    seeds = np.random.default_rng(SEED).choice(len(logs), N_GROUPS, replace=False)
    size = largest // N_GROUPS
    squares = np.einsum("ij,ij->i", logs, logs)  # (N,)
    near = []
    # Several seeds in each pass over the table, which takes as long as for one.
    for some in np.array_split(seeds, len(seeds) // SEEDS_AT_ONCE):
        gaps = squares - 2 * (logs[some] @ logs.T)  # (s, N)
        near += [np.argpartition(row, size)[:size] for row in gaps]
    return np.unique(np.concatenate(near))
