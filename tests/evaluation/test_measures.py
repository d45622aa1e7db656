"""Rankings and measures, worked by hand."""

from collections.abc import Iterator
from math import log2

import numpy as np
import pytest

from pcretrieve.evaluation.measures import (
    MEASURES,
    RetrievalMeasures,
    evaluate_rankings,
    precision_recall,
    query_scores,
)
from pcretrieve.evaluation.rankings import Rankings, rank_gallery
from pcretrieve.retrieval import DistanceBlock
from pcretrieve.values import FloatArray

# Two classes, X = abc and Y = de, and the order in which each shape finds the others.
LABELS = {"a": "X", "b": "X", "c": "X", "d": "Y", "e": "Y"}
ORDERS = {"a": "bdce", "b": "deac", "c": "abde", "d": "eabc", "e": "adbc"}


def distances_of(orders: dict[str, str]) -> FloatArray:
    """(N, N) distances that rank the shapes, in order of the keys, as told."""
    return np.array(
        [[0 if j == i else 1 + order.index(j) for j in orders] for i, order in orders.items()], float
    )


def ranked(orders: dict[str, str], labels: dict[str, str | None], failed: str = "") -> Rankings:
    block = DistanceBlock(np.arange(len(orders)), distances_of(orders))
    lost = {f"failed {number}": label for number, label in enumerate(failed)}
    return rank_gallery([block], list(orders), [labels.get(i) for i in orders], failed=lost)


def measured(orders: dict[str, str], labels: dict[str, str | None], failed: str = "") -> RetrievalMeasures:
    return evaluate_rankings(ranked(orders, labels, failed))


def by_rows(distances: FloatArray) -> Iterator[DistanceBlock]:
    """One row at a time, the last one first."""
    for row in range(len(distances))[::-1]:
        yield DistanceBlock(np.array([row]), distances[row : row + 1])


def test_hand_worked_scores() -> None:
    scores = query_scores(ranked(ORDERS, {**LABELS}))
    assert scores.ids == tuple("abcde")
    assert scores.labels == tuple("XXXYY")
    third = 1 / log2(3)
    np.testing.assert_allclose(scores.nn, [1, 0, 1, 1, 0])
    np.testing.assert_allclose(scores.ft, [1 / 2, 0, 1, 1, 0])
    np.testing.assert_allclose(scores.st, [1, 1, 1, 1, 1])
    # All 4 others are among the 32 nearest: recall is 1, precision R / 4.
    np.testing.assert_allclose(scores.e, [2 / 3, 2 / 3, 2 / 3, 2 / 5, 2 / 5])
    # Ranks 1 and 2 gain 1 each, rank 3 gains 1 / log₂ 3 and rank 4 a half.
    np.testing.assert_allclose(scores.dcg, [(1 + third) / 2, (third + 1 / 2) / 2, 1, 1, 1])
    np.testing.assert_allclose(scores.ap, [(1 + 2 / 3) / 2, (1 / 3 + 2 / 4) / 2, 1, 1, 1 / 2])
    means = measured(ORDERS, {**LABELS})
    values = [getattr(means, name) for name in MEASURES]
    assert values == pytest.approx(scores.columns.mean(axis=0).tolist())
    assert means.map == pytest.approx(3 / 4)
    assert (means.n_queries, means.n_failed, means.n_single) == (5, 0, 0)


def test_shapes_that_are_no_queries_stand_in_the_way() -> None:
    """A class of one, and shapes without a label, which have no class in common."""
    alone = measured({"a": "xb", "b": "xa", "x": "ab"}, {"a": "A", "b": "A", "x": "alone"})
    assert (alone.n_queries, alone.n_single) == (2, 1)
    assert (alone.nn, alone.st, alone.map) == (0, 1, 1 / 2)
    strangers = measured({"a": "xyb", "b": "ayx", "x": "yab", "y": "xab"}, {"a": "A", "b": "A"})
    assert (strangers.n_queries, strangers.n_single) == (2, 0)
    # The second tier of a class of two has two places, and b is third on a's list.
    assert (strangers.nn, strangers.st, strangers.map) == (1 / 2, 1 / 2, (1 / 3 + 1) / 2)


def test_a_failed_shape_is_a_query_without_score_and_a_miss_for_its_class() -> None:
    result = ranked({"a": "bx", "b": "ax", "x": "ab"}, {"a": "A", "b": "A"}, failed="A")
    scores = query_scores(result)
    assert scores.ids == ("a", "b", "failed 0")
    assert scores.labels == ("A", "A", "A")
    # R = 2, one of them found at rank 1 of 2.
    np.testing.assert_allclose(scores.nn, [1, 1, 0])
    np.testing.assert_allclose(scores.ft, [1 / 2, 1 / 2, 0])
    np.testing.assert_allclose(scores.st, [1 / 2, 1 / 2, 0])
    np.testing.assert_allclose(scores.e, [2 / (2 + 2), 2 / (2 + 2), 0])
    np.testing.assert_allclose(scores.dcg, [1 / 2, 1 / 2, 0])
    np.testing.assert_allclose(scores.ap, [1 / 2, 1 / 2, 0])
    means = evaluate_rankings(result)
    assert (means.n_queries, means.n_failed) == (3, 1)
    assert means.nn == pytest.approx(2 / 3)


def test_classes_larger_than_the_list_of_e_and_than_the_second_tier() -> None:
    """40 shapes of one class, 32 shown: E is below 1. Behind 5 others, 2R = 78 nearest are all 44."""
    ids, labels = [f"{i:02}" for i in range(45)], ["A"] * 40 + [None] * 5

    def of_class_at(own: float) -> RetrievalMeasures:
        rows = np.tile(np.where(np.arange(45) < 40, own, 1.5), (40, 1))
        return evaluate_rankings(rank_gallery([DistanceBlock(np.arange(40), rows)], ids, labels))

    near, far = of_class_at(1.0), of_class_at(2.0)
    assert near.e == pytest.approx(2 / (1 / 1 + 39 / 32))
    assert (near.nn, near.ft, near.st, near.dcg, near.map) == pytest.approx((1, 1, 1, 1, 1))
    assert (far.nn, far.st) == (0, 1)
    assert far.ft == pytest.approx(34 / 39)
    assert far.e == pytest.approx(2 * 27 / (32 + 39))


def test_ranks_are_those_of_sorting_by_distance_and_id() -> None:
    """Whatever the blocks. The average precision is that of scikit-learn, and 1 for a perfect ranking."""
    from sklearn.metrics import average_precision_score

    rng = np.random.default_rng(0)
    labels: list[str | None] = [f"class {number}" for number in rng.integers(0, 8, 200)]
    ids, distances = [f"T{number}" for number in rng.permutation(200)], rng.random((200, 200))
    result = rank_gallery(by_rows(np.round(distances, 1)), ids, labels)
    assert rank_gallery([DistanceBlock(np.arange(200), np.round(distances, 1))], ids, labels) == result
    scores = query_scores(rank_gallery(by_rows(distances), ids, labels))
    names = np.array(labels, dtype=str)
    for query in range(200):
        others = [i for i in range(200) if i != query]
        precision = average_precision_score(names[others] == names[query], -distances[query, others])
        assert scores.ap[query] == pytest.approx(precision)
        others.sort(key=lambda i: (round(distances[query, i], 1), ids[i]))
        expected = [rank for rank, i in enumerate(others, start=1) if labels[i] == labels[query]]
        assert result.hit_rank[result.hit_query == query].tolist() == expected
    perfect = rank_gallery(by_rows((names[:, np.newaxis] != names).astype(float)), ids, labels)
    means = evaluate_rankings(perfect)
    assert (means.nn, means.ft, means.st, means.dcg, means.map) == pytest.approx((1, 1, 1, 1, 1))


def test_precision_recall_hand_worked() -> None:
    # Query a alone: hits at ranks 1 and 3 of R = 2, so precision 1 up to recall ½ and ⅔ beyond.
    result = ranked({"a": "bdc", "b": "acd", "c": "abd", "d": "abc"}, {"a": "X", "b": "X", "c": "X"})
    curve = precision_recall(result, n_points=5)
    assert curve.recall.tolist() == [0, 0.25, 0.5, 0.75, 1]
    np.testing.assert_allclose(curve.precision, [1, 1, 1, (2 / 3 + 1 + 1) / 3, (2 / 3 + 1 + 1) / 3])
