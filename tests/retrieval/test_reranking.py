"""Re-ranking: invariants, and agreement with the formulas of the papers written out for dense matrices."""

from __future__ import annotations

import numpy as np

from pcretrieve.retrieval import pairwise
from pcretrieve.retrieval.distances import pairwise_blocks
from pcretrieve.retrieval.reranking import (
    NeighbourLists,
    k_reciprocal,
    neighbour_lists,
    rerank,
)
from pcretrieve.values import FloatArray


def some_points(n: int = 60, *, seed: int = 0) -> FloatArray:
    rng = np.random.default_rng(seed)
    return np.repeat(rng.normal(size=(n // 6, 8)), 6, axis=0) + 0.4 * rng.normal(
        size=(n, 8)
    )


def lists_of(points: FloatArray, k: int = 100) -> NeighbourLists:
    return neighbour_lists(
        pairwise_blocks("log", points, np.arange(len(points))), len(points), k
    )


def test_a_list_keeps_its_shapes_and_its_first() -> None:
    points = some_points()
    lists = lists_of(points, 20)
    order = rerank(lists)
    np.testing.assert_array_equal(order[:, :2], lists.order[:, :2])
    np.testing.assert_array_equal(np.sort(order, axis=1), np.sort(lists.order, axis=1))
    np.testing.assert_array_equal(rerank(lists, np.array([7, 3])), order[[7, 3]])
    assert (order != lists.order).any()
    # In any unit.
    np.testing.assert_array_equal(rerank(lists_of(1024 * points, 20)), order)
    for n in (1, 2, 3, 4):
        for few in (np.ones((n, 3)), np.random.default_rng(0).normal(size=(n, 3))):
            assert np.sort(rerank(lists_of(few)), axis=1).tolist() == [list(range(n))] * n


def test_a_hundred_results_are_sorted_again() -> None:
    points = some_points(150)
    assert neighbour_lists(
        pairwise_blocks("log", points, np.arange(150)), 150
    ).order.shape == (
        150,
        101,
    )


def test_k_reciprocal_is_that_of_sets() -> None:
    """Zhong et al., equations 2 to 12, with sets and loops."""
    points = some_points()
    lists = lists_of(points)
    distances = pairwise("log", points, points)
    order, n = np.argsort(distances, axis=1, kind="stable"), len(points)
    k1, k2, weight = 12, 4, 0.3

    def reciprocal(i: int, k: int) -> set[int]:
        return {j for j in order[i, : k + 1].tolist() if i in order[j, : k + 1]}

    features = np.zeros((n, n))
    for i in range(n):
        members = reciprocal(i, k1)
        for j in reciprocal(i, k1):
            own = reciprocal(j, k1 // 2)
            if len(own & reciprocal(i, k1)) > 2 / 3 * len(own):
                members |= own
        rows = sorted(members)
        features[i, rows] = np.exp(
            -distances[i, rows] / distances[i, order[i, 1 : k1 + 1]].mean()
        )
    features /= features.sum(axis=1, keepdims=True)
    features = np.array([features[order[i, :k2]].mean(axis=0) for i in range(n)])
    for i in range(n):
        common = np.minimum(features[i], features).sum(axis=1)
        own_mean = distances[i, order[i, 1:]].mean()
        expected = (1 - weight) * (1 - common / (2 - common)) + weight * distances[
            i
        ] / own_mean
        found = k_reciprocal(lists, np.array([i]))[0]
        np.testing.assert_allclose(found, expected[lists.order[i]], atol=1e-12)
