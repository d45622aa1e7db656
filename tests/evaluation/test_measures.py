"""Rankings and measures, worked by hand; their files, and comparisons of two results."""

import csv
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from math import log2
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import bootstrap

import pcretrieve as pr
from pcretrieve.errors import BenchmarkError, InputError
from pcretrieve.evaluation import measures
from pcretrieve.evaluation.comparison import compare_scores, read_scores, write_evaluation
from pcretrieve.evaluation.measures import (
    MEASURES,
    QueryScores,
    RetrievalMeasures,
    bootstrap_interval,
    class_measures,
    confusion,
    evaluate_rankings,
    precision_recall,
    query_scores,
    recognition_curve,
    verification,
)
from pcretrieve.evaluation.rankings import NO_FAILURES, Rankings, Subset, rank_subsets
from pcretrieve.retrieval import DistanceBlock
from pcretrieve.values import FloatArray


def rank_gallery(
    blocks: Iterable[DistanceBlock],
    ids: Sequence[str],
    labels: Sequence[str | None],
    failed: Mapping[str, str | None] = NO_FAILURES,
) -> Rankings:
    return rank_subsets(
        [Subset(np.arange(len(ids)), blocks)], ids, labels, failed=failed
    )[0]


def ranked(
    orders: dict[str, str], labels: Mapping[str, str], failed: str = ""
) -> Rankings:
    """Shapes that find each other in these orders; and failed ones of some classes."""
    distances = [
        [0 if j == i else 1 + order.index(j) for j in orders]
        for i, order in orders.items()
    ]
    block = DistanceBlock(np.arange(len(orders)), np.array(distances, dtype=np.float64))
    lost: dict[str, str | None] = {
        f"failed {number}": label for number, label in enumerate(failed)
    }
    return rank_gallery(
        [block], list(orders), [labels.get(i) for i in orders], failed=lost
    )


def by_rows(distances: FloatArray) -> Iterator[DistanceBlock]:
    """One row at a time, the last one first."""
    for row in range(len(distances))[::-1]:
        yield DistanceBlock(np.array([row]), distances[row : row + 1])


def test_distances_and_labels_may_be_plain() -> None:
    places = np.array([0, 1, 2, 10, 11, 30])
    distances = abs(places[:, None] - places)
    labels = ["a", "a", "b", "b", "b", None]
    found = pr.evaluate(distances, labels)
    ids = tuple("012345")
    kept = pr.DistanceMatrix(ids, distances, tuple(labels))
    assert (found.nn, found.n_queries) == (4 / 5, 5)
    for same in (
        pr.evaluate(kept),
        pr.evaluate(pr.DistanceMatrix(ids, distances), np.array(labels, dtype=object)),
        pr.evaluate(distances.tolist(), labels),
    ):
        assert (same.map, same.scores) == (found.map, found.scores)
    numbered = pr.evaluate(distances, [1, 1, 2, 2, 2, 3])
    assert numbered.map == found.map and numbered.scores.labels[0] == "1"


def test_rows_of_plain_distances_are_in_order() -> None:
    """Equal distances are ranked by id: of eleven rows, row 2 comes before row 10."""
    found = pr.evaluate(np.ones((11, 11)), ["a", *10 * "b"])
    assert found.scores.ids == tuple(f"{row:02}" for row in range(1, 11))
    assert found.ranked.rankings.nearest[0] == "00"


def test_distances_that_fit_no_labels_are_refused() -> None:
    square = np.ones((3, 3))
    with pytest.raises(
        BenchmarkError, match="no row of the distances has a class: give labels"
    ):
        pr.evaluate(square)
    with pytest.raises(InputError, match=r"labels must be as many as ids \(3\), got 2"):
        pr.evaluate(square, ["a", "a"])
    with pytest.raises(
        InputError, match=r"a distance matrix must have shape \(2, 2\), got \(2, 3\)"
    ):
        pr.evaluate(square[:2], ["a", "a"])
    with pytest.raises(
        InputError, match="labels of a catalogue must be a label file or a layout"
    ):
        pr.evaluate("bodies.sqlite", ["a", "a"])


def test_hand_worked_scores() -> None:
    orders = {"a": "bdce", "b": "deac", "c": "abde", "d": "eabc", "e": "adbc"}
    result = ranked(orders, dict(zip("abcde", "XXXYY", strict=True)))
    scores = query_scores(result)
    assert (scores.ids, scores.labels) == (tuple("abcde"), tuple("XXXYY"))
    third = 1 / log2(3)
    np.testing.assert_allclose(scores.nn, [1, 0, 1, 1, 0])
    np.testing.assert_allclose(scores.ft, [1 / 2, 0, 1, 1, 0])
    np.testing.assert_allclose(scores.st, [1, 1, 1, 1, 1])
    # All 4 others are among the 32 nearest: recall is 1, precision R / 4.
    np.testing.assert_allclose(scores.e, [2 / 3, 2 / 3, 2 / 3, 2 / 5, 2 / 5])
    # Ranks 1 and 2 gain 1 each, rank 3 gains 1 / log₂ 3 and rank 4 a half.
    np.testing.assert_allclose(
        scores.dcg, [(1 + third) / 2, (third + 1 / 2) / 2, 1, 1, 1]
    )
    np.testing.assert_allclose(
        scores.ap, [(1 + 2 / 3) / 2, (1 / 3 + 2 / 4) / 2, 1, 1, 1 / 2]
    )
    means = evaluate_rankings(result)
    values = [getattr(means, name) for name in MEASURES]
    assert values == pytest.approx(scores.columns.mean(axis=0).tolist())
    assert means.nn == pytest.approx(3 / 5)
    # In which the classes have one weight.
    macro = evaluate_rankings(result, average="macro")
    assert macro.nn == pytest.approx((2 / 3 + 1 / 2) / 2)
    assert (means.n_queries, means.n_failed, means.n_single) == (5, 0, 0)


def test_shapes_that_are_no_queries_stand_in_the_way() -> None:
    """A class of one, and shapes without a label, which have no class in common."""
    labels = {"a": "A", "b": "A"}
    alone = evaluate_rankings(
        ranked({"a": "xb", "b": "xa", "x": "ab"}, {**labels, "x": "alone"})
    )
    assert (alone.n_queries, alone.n_single) == (2, 1)
    assert (alone.nn, alone.st, alone.map) == (0, 1, 1 / 2)
    strangers = evaluate_rankings(
        ranked({"a": "xyb", "b": "ayx", "x": "yab", "y": "xab"}, labels)
    )
    assert (strangers.n_queries, strangers.n_single) == (2, 0)
    # The second tier of a class of two has two places, and b is third on a's list.
    assert (strangers.nn, strangers.st, strangers.map) == (1 / 2, 1 / 2, (1 / 3 + 1) / 2)


def test_a_failed_shape_is_a_query_without_score_and_a_miss_for_its_class() -> None:
    result = ranked({"a": "bx", "b": "ax", "x": "ab"}, {"a": "A", "b": "A"}, failed="A")
    scores = query_scores(result)
    assert scores.ids == ("a", "b", "failed 0")
    assert scores.labels == ("A", "A", "A")
    # R = 2, one of them found at rank 1 of 2; so that E is 2 / (2 + 2).
    expected = dict.fromkeys(MEASURES, 1 / 2) | {"nn": 1}
    np.testing.assert_allclose(scores.columns, [[*expected.values()]] * 2 + [[0] * 6])
    means = evaluate_rankings(result)
    assert (means.n_queries, means.n_failed) == (3, 1)
    assert means.nn == pytest.approx(2 / 3)


def test_classes_larger_than_the_list_of_e_and_than_the_second_tier() -> None:
    """40 shapes of one class, 32 shown: E is below 1. Behind 5 others, 2R = 78 nearest are all 44."""
    ids, labels = [f"{i:02}" for i in range(45)], ["A"] * 40 + [None] * 5

    def of_class_at(own: float) -> RetrievalMeasures:
        rows = np.tile(np.where(np.arange(45) < 40, own, 1.5), (40, 1))
        return evaluate_rankings(
            rank_gallery([DistanceBlock(np.arange(40), rows)], ids, labels)
        )

    near, far = of_class_at(1.0), of_class_at(2.0)
    assert near.e == pytest.approx(2 / (1 / 1 + 39 / 32))
    assert (near.nn, near.ft, near.st, near.dcg, near.map) == pytest.approx(
        (1, 1, 1, 1, 1)
    )
    assert (far.nn, far.st) == (0, 1)
    assert far.ft == pytest.approx(34 / 39)
    assert far.e == pytest.approx(2 * 27 / (32 + 39))


def test_ranks_are_those_of_sorting_by_distance_and_id() -> None:
    """Whatever the blocks. The average precision and the errors of pairs are those of scikit-learn."""
    from sklearn.metrics import average_precision_score, roc_curve

    rng = np.random.default_rng(0)
    labels: list[str | None] = [f"class {number}" for number in rng.integers(0, 8, 200)]
    ids, distances = (
        [f"T{number}" for number in rng.permutation(200)],
        rng.random((200, 200)),
    )
    result = rank_gallery(by_rows(np.round(distances, 1)), ids, labels)
    assert (
        rank_gallery([DistanceBlock(np.arange(200), np.round(distances, 1))], ids, labels)
        == result
    )
    scores = query_scores(rank_gallery(by_rows(distances), ids, labels))
    names = np.array(labels, dtype=str)
    rates, pairs = verification(result.genuine, result.impostor), ~np.eye(200, dtype=bool)
    same = (names[:, None] == names)[pairs]
    matched, accepted, _ = roc_curve(
        same, -np.round(distances, 1)[pairs], drop_intermediate=False
    )
    assert rates is not None
    np.testing.assert_allclose(rates.false_match, matched)
    np.testing.assert_allclose(1 - rates.false_non_match, accepted, atol=1e-12)
    assert rates.missed(0.3) == 1 - accepted[matched <= 0.3][-1]
    for query in range(200):
        others = [i for i in range(200) if i != query]
        precision = average_precision_score(
            names[others] == names[query], -distances[query, others]
        )
        assert scores.ap[query] == pytest.approx(precision)
        others.sort(key=lambda i: (round(distances[query, i], 1), ids[i]))
        expected = [
            rank for rank, i in enumerate(others, start=1) if labels[i] == labels[query]
        ]
        assert result.hit_rank[result.hit_query == query].tolist() == expected


def test_errors_of_pairs_hand_worked() -> None:
    """Limits at the pairs of one class: a quarter of the others is within 2, and a half within 3."""
    rates = verification(np.array([1.0, 2.0, 3.0]), np.array([1.5, 2.5, 3.5, 4.0]))
    assert rates is not None
    found = [rates.missed(rate) for rate in (0.0, 0.2, 0.25, 0.4, 0.5, 1.0)]
    np.testing.assert_allclose(found, [2 / 3, 2 / 3, 1 / 3, 1 / 3, 0, 0], atol=1e-12)


def test_precision_recall_hand_worked() -> None:
    # Query a alone: hits at ranks 1 and 3 of R = 2, so precision 1 up to recall ½ and ⅔ beyond.
    result = ranked(
        {"a": "bdc", "b": "acd", "c": "abd", "d": "abc"}, {"a": "X", "b": "X", "c": "X"}
    )
    curve = precision_recall(result, n_points=5)
    assert curve.recall.tolist() == [0, 0.25, 0.5, 0.75, 1]
    np.testing.assert_allclose(
        curve.precision, [1, 1, 1, (2 / 3 + 1 + 1) / 3, (2 / 3 + 1 + 1) / 3]
    )


# --- classes and files ----------------------------------------------------------------------------------


def test_measures_confusions_and_files_of_classes(tmp_path: Path) -> None:
    """X = abc, Y = de and a failed shape; and z has no class."""
    orders = {
        "a": "bczde",
        "b": "dacez",
        "c": "zabde",
        "d": "eabcz",
        "e": "abcdz",
        "z": "abcde",
    }
    result = ranked(orders, dict(zip("abcde", "XXXYY", strict=True)), failed="Y")
    scores = query_scores(result)
    x, y = class_measures(result)
    assert (x.label, x.n_queries, x.confused) == ("X", 3, ((None, 1), ("Y", 1)))
    assert (y.label, y.n_queries, y.confused) == ("Y", 3, (("X", 1),))
    np.testing.assert_allclose(x.means, scores.columns[:3].mean(axis=0))
    found = confusion(result)
    assert (found.labels, found.nearest) == (("X", "Y"), ("X", "Y", None))
    assert found.counts.tolist() == [[1, 1, 1], [1, 1, 0]]
    points = recognition_curve(result.n_nearer, result.labels, result.n_classes)
    written = write_evaluation(result, tmp_path / "new" / "folder", points)
    tables = {
        path.stem: list(csv.reader(path.read_text(encoding="utf-8").splitlines()))
        for path in written
    }
    assert tables["confusion"] == [
        ["label", "X", "Y", ""],
        ["X", "1", "1", "1"],
        ["Y", "1", "1", "0"],
    ]
    assert [row[:2] for row in tables["classes"]] == [
        ["label", "n_queries"],
        ["X", "3"],
        ["Y", "3"],
    ]
    assert float(tables["classes"][1][7]) == x.means[5]
    assert (tables["queries"][3][0], *tables["queries"][3][-2:]) == ("c", "z", "")
    assert tables["queries"][6][0] == "failed 0"
    assert [row[0] for row in tables["precision_recall"]][:2] == ["recall", "0.0"]
    assert len(tables["precision_recall"]) == 12
    assert read_scores(written[0]) == scores


def test_files_that_hold_no_measures(tmp_path: Path) -> None:
    head = "id,label,nn,ft,st,e,dcg"
    for text, message in (
        (
            f"{head}\na,X,1,1,1,1,1\n",
            "must have the columns id, label, nn, ft, st, e, dcg, ap",
        ),
        (f"{head},ap\na,X,1,1,1,1,1,one\n", "must have the columns"),
        (f"{head},ap\na,X,1,1,1,1\n", "must have the columns"),
        (f"{head},ap\n", "must have each query once, got 0 rows of 0 queries"),
        (f"{head},ap\na,X,1,1,1,1,1,1\na,X,1,1,1,1,1,1\n", "got 2 rows of 1 queries"),
        (f"{head},ap\na,X,1,1,1,1,1,1.5\n", "must lie between 0 and 1"),
        (f"{head},ap\na,X,1,1,1,1,1,nan\n", "must lie between 0 and 1"),
    ):
        (tmp_path / "queries.csv").write_text(text)
        with pytest.raises(InputError, match=message):
            read_scores(tmp_path / "queries.csv")


# --- comparisons ----------------------------------------------------------------------------------------

EASE = np.random.default_rng(0).random(100)


def equal_scores(ap: FloatArray, *, start: int = 0) -> QueryScores:
    """Measures that are all equal, of queries with consecutive names."""
    ids = tuple(f"{start + number:03}" for number in range(len(ap)))
    return QueryScores(ids, ("X",) * len(ap), *(ap,) * 6)


def test_small_differences_show_beside_large_ones_between_queries() -> None:
    """The measures of a result vary by .3 from query to query, their differences by .005."""
    gains = 0.005 + 0.005 * np.random.default_rng(1).normal(size=100)
    first, second = equal_scores(0.9 * EASE), equal_scores(0.9 * EASE + np.abs(gains))
    found = compare_scores(first, second)
    np.testing.assert_allclose(found.difference, np.abs(gains).mean())
    assert (found.interval[0] > 0).all()
    assert np.ptp(found.interval, axis=1) == pytest.approx([0, 0]), (
        "columns of a row are drawn together"
    )
    low, high = bootstrap_interval(first.columns)
    assert (high - low > 10 * (found.interval[1] - found.interval[0])).all()
    reverse = compare_scores(second, first)
    np.testing.assert_allclose(reverse.interval, -found.interval[::-1])
    np.testing.assert_allclose(reverse.difference, -found.difference)


def test_queries_are_matched_by_their_ids() -> None:
    """The largest changes come first; queries that one result lacks are left out and named."""
    order = np.random.default_rng(2).permutation(100)
    changed = EASE / 2 + 0.25
    shuffled = replace(
        equal_scores(changed[order]), ids=tuple(f"{row:03}" for row in order)
    )
    found = compare_scores(equal_scores(EASE), shuffled)
    np.testing.assert_allclose(found.difference, (changed - EASE).mean())
    steps = [abs(one.second - one.first) for one in found.changes]
    assert steps == sorted(steps, reverse=True)
    assert len(steps) == 100
    row = int(np.argmax(np.abs(changed - EASE)))
    assert found.changes[0] == (f"{row:03}", "X", EASE[row], changed[row])
    some = compare_scores(equal_scores(EASE[:60]), equal_scores(EASE[10:], start=10))
    assert some.only_first == tuple(f"{number:03}" for number in range(10))
    assert some.only_second == tuple(f"{number:03}" for number in range(60, 100))
    np.testing.assert_allclose([some.first, some.second], EASE[10:60].mean())


def test_results_of_other_shapes_or_classes() -> None:
    with pytest.raises(
        InputError, match="must have queries in common, got none of 100 and 100"
    ):
        compare_scores(equal_scores(EASE), equal_scores(EASE, start=500))
    other = replace(equal_scores(EASE), labels=("X",) * 98 + ("Y", "Z"))
    with pytest.raises(
        InputError,
        match="the same class in both results, 2 have another, such as 098, 099",
    ):
        compare_scores(equal_scores(EASE), other)


def test_the_interval_agrees_with_that_of_scipy() -> None:
    values = np.random.default_rng(0).beta(5, 1, size=(200, 2))
    low, high = bootstrap_interval(values)
    expected = bootstrap(
        (values,), np.mean, confidence_level=0.95, method="percentile", rng=1
    )
    ends = expected.confidence_interval
    assert (
        np.abs([low - ends.low, high - ends.high]) < 0.1 * (ends.high - ends.low)
    ).all()


def test_a_curve_is_the_mean_over_all_collections() -> None:
    """Of seven people in three scans each, and one alone, beside brute force over every subset."""
    rng = np.random.default_rng(4)
    labels = [name for name in "abcdefg" for _ in range(3)] + ["h", None]
    places = np.repeat(rng.normal(size=(9, 3)), [3] * 7 + [1, 1], axis=0)
    places += rng.normal(0, 0.6, places.shape)
    distances = np.linalg.norm(places[:, None] - places, axis=2)
    found = pr.evaluate(distances, labels)
    *parts, whole = (point for point in found.curve if not point.is_fitted)
    assert [point.n_classes for point in parts] == [2, 3, 5]
    assert parts[0].rank_1 > parts[1].rank_1 > parts[2].rank_1 > whole.rank_1
    assert whole.rank_1 == pytest.approx(found.nn)
    assert whole.low < whole.rank_1 < whole.high
    rankings = found.ranked.rankings
    classes = np.array(labels[:21])
    rates: dict[int, list[float]] = {n: [] for n in range(2, 9)}
    for query in range(21):
        own = str(labels[query])
        others = sorted(set("abcdefgh") - {own})
        nearest = {
            name: min(
                distances[query, i]
                for i, label in enumerate(labels)
                if label == name and i != query
            )
            for name in "abcdefgh"
        }
        for n, right in rates.items():
            drawn = combinations(others, n - 1)
            right.append(
                float(np.mean([min(nearest[i] for i in s) > nearest[own] for s in drawn]))
            )
    for n, right in rates.items():
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(measures, "SIZES", (n,))
            points = recognition_curve(rankings.n_nearer, classes, 8)
        assert points[0].n_classes == n
        assert points[0].rank_1 == pytest.approx(np.mean(right))


def test_a_curve_counts_failures_and_is_continued_as_a_power() -> None:
    """The own class is behind 0, 1 or 99 of 99 others."""
    nearer = np.repeat([0, 1, 99], [180, 16, 4])
    labels = np.arange(200) % 100
    _, _, _, ten, thirty, hundred, *fitted = recognition_curve(nearer, labels, 100)
    assert (ten.n_classes, thirty.n_classes, hundred.n_classes) == (10, 30, 100)
    assert ten.rank_1 == pytest.approx((180 + 16 * 90 / 99) / 200)
    assert hundred.rank_1 == pytest.approx(0.9)
    assert hundred.rank_5 == pytest.approx(0.98)
    assert [point.n_classes for point in fitted] == [300, 1000]
    assert all(point.is_fitted and np.isnan(point.rank_5) for point in fitted)
    assert hundred.rank_1 > fitted[0].rank_1 > fitted[1].rank_1


def test_failed_shapes_and_lists_without_a_hit_count_as_found_last() -> None:
    one = ranked(
        {"a1": "b1 a2", "a2": "a1 b1", "b1": "a1 a2"},
        {"a1": "a", "a2": "a", "b1": "b"},
        "b",
    )
    assert dict(zip(one.ids, one.n_nearer.tolist(), strict=True)) == {
        "a1": 1,
        "a2": 0,
        "b1": 1,
        "failed 0": 1,
    }
