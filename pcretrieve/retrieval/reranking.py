"""Re-ranking: a ranked list sorted again by how the neighbourhoods of the query and of each result overlap.

``k-reciprocal`` [1]_ compares the sets of shapes that are mutually among the k nearest: shapes of one class
share most of these neighbours.

Only the first results of a list are sorted again, and the nearest shape keeps its rank.

References
----------
.. [1] Zhong, Zheng, Cao and Li, "Re-ranking person re-identification with k-reciprocal encoding", CVPR 2017,
   equations 2 to 12.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pcretrieve.retrieval.distances import DistanceBlock, Positions
from pcretrieve.values import FloatArray, Neighbors

if TYPE_CHECKING:
    from scipy.sparse import csr_array

#: Number of results of each query that are sorted again.
N_RERANKED = 100

#: Number of shapes nearest to a query whose neighbourhoods are computed, among these shapes.
N_NEAR = 300

# k₁, k₂ and λ. See docs/decisions.md, K_RECIPROCAL.
K_RECIPROCAL = (12, 4, 0.3)

# Share of the reciprocal neighbours of a neighbour that must be in the set before the others are added.
EXPANDED = 2 / 3


class NeighbourLists(NamedTuple):
    """The positions (N, K) of the shapes nearest to each of N shapes, itself first, and their distances."""

    order: Positions
    distances: FloatArray


def neighbour_lists(
    blocks: Iterable[DistanceBlock], n: int, k: int = N_RERANKED
) -> NeighbourLists:
    """The nearest shapes of all shapes of a gallery."""
    length = min(k + 1, n)
    order, distances = np.empty((n, length), dtype=np.intp), np.empty((n, length))
    for queries, block in blocks:
        columns = block.copy()
        # A shape is the first in its own list.
        columns[np.arange(len(queries)), queries] = -np.inf
        nearest = _first_columns(columns, length)
        order[queries] = nearest
        distances[queries] = np.take_along_axis(block, nearest, axis=1)
    return NeighbourLists(order, distances)


def _first_columns(values: FloatArray, length: int) -> Positions:
    """The columns (n, length) of the smallest values in each row, ascending; equal values by column."""
    if length == values.shape[1]:
        return np.argsort(values, axis=1, kind="stable")
    # In time proportional to the number of columns, unlike a sorting of whole rows.
    columns = np.sort(np.argpartition(values, length - 1, axis=1)[:, :length], axis=1)
    chosen = np.take_along_axis(values, columns, axis=1)  # (n, length)
    first = np.take_along_axis(columns, np.argsort(chosen, axis=1, kind="stable"), axis=1)
    # Which of several values that equal the largest chosen one are chosen is left to chance.
    tied = (values <= chosen.max(axis=1, keepdims=True)).sum(axis=1) > length
    first[tied] = np.argsort(values[tied], axis=1, kind="stable")[:, :length]
    return first


def rerank(
    lists: NeighbourLists,
    rows: Positions | None = None,
    *,
    parameters: tuple[int, int, float] = K_RECIPROCAL,
) -> Positions:
    """Sort the lists of some shapes again.

    rows: (Q,) intp, optional, the queries, positions in the gallery. By default all.
    parameters: k₁, k₂ and λ, as in `k_reciprocal`.
    Returns (Q, K) intp: the shapes of the lists of the queries in their new order; the first two, which are
        the query and the shape nearest to it, keep their places.
    """
    rows = np.arange(len(lists.order)) if rows is None else rows
    if lists.order.shape[1] < 3:
        return lists.order[rows]
    distances = k_reciprocal(lists, rows, parameters)
    distances[:, :2] = -np.inf
    order = np.argsort(distances, axis=1, kind="stable")
    return np.take_along_axis(lists.order[rows], order, axis=1)


def reranked_neighbors(
    found: Neighbors, apart: FloatArray, shape_id: str | None
) -> Neighbors:
    """Sort the results of one query again, which is itself the shape of an id, if it has one.

    apart: (n, n) float64, the distances of the results from each other.
    """
    n = len(found)
    if n < 3:
        return found
    distances = np.zeros((n + 1, n + 1))  # the query is last
    distances[:n, :n] = apart
    distances[n, :n] = distances[:n, n] = found.distances
    held = [(0.0, shape_id)] if shape_id is not None and shape_id in found.ids else []
    query, size = (found.ids.index(held[0][1]), n) if held else (n, n + 1)
    lists = neighbour_lists(
        [DistanceBlock(np.arange(size), distances[:size, :size])], size
    )
    order = lists.order[query][1:]  # without the query
    new = k_reciprocal(lists, np.array([query]))[0, 1:]
    if len(new) > 1:
        # Just below the others, so that equal distances remain in alphabetical order.
        new[0] = min(new[0], np.nextafter(new[1:].min(), -np.inf))
    new = np.maximum(new, 0)
    names = [found.ids[number] for number in order]
    results = sorted([*held, *zip(new.tolist(), names, strict=True)])
    last = results[-1][0]
    later = [number for number in range(n) if number not in {query, *order.tolist()}]
    results += [
        (last + float(found.distances[number]), found.ids[number]) for number in later
    ]
    return Neighbors(
        tuple(name for _, name in results), np.array([gap for gap, _ in results])
    )


def k_reciprocal(
    lists: NeighbourLists,
    rows: Positions,
    parameters: tuple[int, int, float] = K_RECIPROCAL,
) -> FloatArray:
    """Jaccard distances of the k-reciprocal neighbourhoods, plus a share of the original distances.

    rows: (Q,) intp, the queries.
    parameters: k₁ and k₂, the sizes of the reciprocal sets and of the query expansion, and λ, the weight of
        the original distance, relative to the mean distance in the list of the query, beside the Jaccard
        distance.
    Returns (Q, K) float64: the distances of the shapes in the lists of the queries; dimensionless.
    """
    # Imported here, because an index without whitening does not need it.
    from scipy.sparse import csr_array

    k1, k2, weight = parameters
    features = _reciprocal_features(lists, k1)
    n_averaged = min(k2, lists.order.shape[1])
    features = csr_array(nearest_matrix(lists.order, k2 - 1) @ features / n_averaged)
    jaccard = _jaccard_distances(features, lists.order[rows], rows)
    plain = lists.distances[rows]
    mean = np.maximum(plain[:, 1:].mean(axis=1, keepdims=True), np.finfo(np.float64).tiny)
    return np.asarray((1 - weight) * jaccard + weight * plain / mean)


def _reciprocal_features(lists: NeighbourLists, k1: int) -> csr_array:
    """(N, N) the weight of each shape in the k-reciprocal neighbourhood of each shape; rows of sum 1."""
    from scipy.sparse import csr_array

    n, length = lists.order.shape
    graphs = (nearest_matrix(lists.order, k) for k in (k1, max(1, k1 // 2)))
    mutual, half = (csr_array(graph.multiply(graph.T)) for graph in graphs)
    # A neighbour brings its own closest neighbours, if most of these are in the set already.
    # (N, N), |R(i) ∩ R½(j)| for j in R(i).
    shared = (mutual @ half.T).multiply(mutual).tocoo()
    sizes = np.asarray(half.sum(axis=1))
    brings = shared.data > EXPANDED * sizes[shared.col]
    bringing = csr_array(
        (np.ones(brings.sum()), (shared.row[brings], shared.col[brings])), shape=(n, n)
    )
    members = csr_array(((mutual + bringing @ half) > 0).astype(np.float64))
    # Gaussian-like weights, relative to the scale of each neighbourhood.
    scale = np.maximum(
        lists.distances[:, 1 : k1 + 1].mean(axis=1), np.finfo(np.float64).tiny
    )
    with np.errstate(over="ignore"):  # neighbourhoods of equal shapes have the scale zero
        near = np.maximum(
            np.exp(-lists.distances / scale[:, None]), np.finfo(np.float64).tiny
        )
    indptr = np.arange(0, n * length + 1, length)
    features = csr_array(
        members.multiply(
            csr_array((near.ravel(), lists.order.ravel(), indptr), shape=(n, n))
        )
    )
    return csr_array(features.multiply(1 / np.asarray(features.sum(axis=1))[:, None]))


def _jaccard_distances(
    features: csr_array, near: Positions, rows: Positions
) -> FloatArray:
    """(Q, K) Jaccard distances of the features of the queries and of their near shapes (Q, K)."""
    by_column = features.tocsc()
    jaccard = np.empty(near.shape)
    for number, row in enumerate(rows):
        overlap = np.zeros(features.shape[0])  # Σ min of the weights, with every shape
        own = slice(features.indptr[row], features.indptr[row + 1])
        for column, value in zip(features.indices[own], features.data[own], strict=True):
            others = slice(by_column.indptr[column], by_column.indptr[column + 1])
            overlap[by_column.indices[others]] += np.minimum(
                by_column.data[others], value
            )
        common = overlap[near[number]]
        jaccard[number] = 1 - common / (2 - common)
    return jaccard


def nearest_matrix(order: Positions, k: int) -> csr_array:
    """The graph (N, N) of lists (N, K): 1 where the column is the row, or among its k nearest."""
    from scipy.sparse import csr_array

    n = len(order)
    near = order[:, : k + 1]
    ends = np.arange(0, near.size + 1, near.shape[1])
    return csr_array((np.ones(near.size), near.ravel(), ends), shape=(n, n))
