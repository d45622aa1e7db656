"""Rankings and measures, worked by hand."""

from collections.abc import Iterator
from dataclasses import asdict
from math import log2

import numpy as np
import pytest

from pcretrieve.errors import InputError
from pcretrieve.evaluation.measures import (
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


def random_benchmark(seed: int = 0, n: int = 60) -> tuple[FloatArray, list[str], list[str | None]]:
    rng = np.random.default_rng(seed)
    labels: list[str | None] = [f"class {number}" for number in rng.integers(0, 8, n)]
    return rng.random((n, n)), [f"T{number}" for number in rng.permutation(n)], labels


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


def test_hand_worked_means() -> None:
    result = measured(ORDERS, {**LABELS})
    assert result.nn == pytest.approx(3 / 5)
    assert result.ft == pytest.approx(1 / 2)
    assert result.st == pytest.approx(1)
    assert result.e == pytest.approx((3 * 2 / 3 + 2 * 2 / 5) / 5)
    assert result.dcg == pytest.approx((3 + (1 + 1 / log2(3)) / 2 + (1 / log2(3) + 1 / 2) / 2) / 5)
    assert result.map == pytest.approx(3 / 4)
    assert (result.n_queries, result.n_failed, result.n_single) == (5, 0, 0)


def test_ties_are_broken_by_id() -> None:
    ids, labels = ["d", "b", "c", "a"], ["X", "Y", "Y", "X"]
    block = DistanceBlock(np.arange(4), np.ones((4, 4)))
    result = rank_gallery([block], ids, labels)
    # d finds a b c; b finds a c d; c finds a b d; a finds b c d.
    assert result.ids == ("d", "b", "c", "a")
    assert result.hit_rank.tolist() == [1, 2, 2, 3]


def test_a_query_does_not_find_itself_even_among_copies() -> None:
    distances = np.zeros((3, 3))
    result = rank_gallery([DistanceBlock(np.arange(3), distances)], ["a", "b", "c"], ["Y", "X", "X"])
    # b is found by c at rank 2 (a comes first), and c by b likewise; a is alone.
    assert result.hit_rank.tolist() == [2, 2]
    assert result.n_single == 1


def test_a_class_of_one_is_no_query_but_stands_in_the_way() -> None:
    result = measured({"a": "xb", "b": "xa", "x": "ab"}, {"a": "A", "b": "A", "x": "alone"})
    assert (result.n_queries, result.n_single) == (2, 1)
    assert (result.nn, result.st, result.map) == (0, 1, 1 / 2)


def test_a_shape_without_label_is_no_query_but_stands_in_the_way() -> None:
    with_strangers = {"a": "xyb", "b": "ayx", "x": "yab", "y": "xab"}
    result = measured(with_strangers, {"a": "A", "b": "A"})
    # Two shapes without a label have no class in common: x and y do not find each other.
    assert (result.n_queries, result.n_single) == (2, 0)
    # The second tier of a class of two has two places, and b is third on a's list.
    assert (result.nn, result.st, result.map) == (1 / 2, 1 / 2, (1 / 3 + 1) / 2)


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


@pytest.mark.parametrize("seed", range(3))
def test_a_perfect_ranking_scores_one(seed: int) -> None:
    _, ids, labels = random_benchmark(seed)
    names = np.array(labels, dtype=str)
    distances = (names[:, np.newaxis] != names).astype(float)
    result = evaluate_rankings(rank_gallery(by_rows(distances), ids, labels))
    assert (result.nn, result.ft, result.st, result.dcg, result.map) == pytest.approx((1, 1, 1, 1, 1))
    assert result.e < 1


def test_blocks_of_any_size_and_order_give_the_same() -> None:
    distances, ids, labels = random_benchmark()
    at_once = rank_gallery([DistanceBlock(np.arange(60), distances)], ids, labels)
    row_by_row = rank_gallery(by_rows(distances), ids, labels)
    assert asdict(evaluate_rankings(at_once)) == asdict(evaluate_rankings(row_by_row))
    assert (at_once.hit_rank == row_by_row.hit_rank).all()


def test_ranks_are_those_of_sorting_by_distance_and_id() -> None:
    distances, ids, labels = random_benchmark(n=200)
    distances = np.round(distances, 1)
    result = rank_gallery(by_rows(distances), ids, labels)
    for query in range(200):
        others = [i for i in range(200) if i != query]
        others.sort(key=lambda i: (distances[query, i], ids[i]))
        expected = [rank for rank, i in enumerate(others, start=1) if labels[i] == labels[query]]
        assert result.hit_rank[result.hit_query == query].tolist() == expected


def test_average_precision_agrees_with_scikit_learn() -> None:
    from sklearn.metrics import average_precision_score

    distances, ids, labels = random_benchmark()
    scores = query_scores(rank_gallery(by_rows(distances), ids, labels))
    for query in range(60):
        others = np.arange(60) != query
        relevant = np.array([label == labels[query] for label in labels])[others]
        expected = average_precision_score(relevant, -distances[query, others])
        assert scores.ap[query] == pytest.approx(expected)


def test_precision_recall_hand_worked() -> None:
    # Query a alone: hits at ranks 1 and 3 of R = 2, so precision 1 up to recall ½ and ⅔ beyond.
    result = ranked({"a": "bdc", "b": "acd", "c": "abd", "d": "abc"}, {"a": "X", "b": "X", "c": "X"})
    curve = precision_recall(result, n_points=5)
    assert curve.recall.tolist() == [0, 0.25, 0.5, 0.75, 1]
    np.testing.assert_allclose(curve.precision, [1, 1, 1, (2 / 3 + 1 + 1) / 3, (2 / 3 + 1 + 1) / 3])


@pytest.mark.parametrize("bad", [np.nan, -1.0, -np.inf])
def test_distances_that_are_none(bad: float) -> None:
    with pytest.raises(InputError, match="must be 0 or more, got 1 that are negative or NaN"):
        rank_gallery([DistanceBlock(np.array([0]), np.array([[0, bad]]))], ["a", "b"], ["A", "A"])
