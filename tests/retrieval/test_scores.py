"""Scores are true of shapes that were not counted; sure answers, near pairs, and maps."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.distance import cdist
from tables import classes_of, table_of

from pcretrieve.errors import InputError
from pcretrieve.gallery.answers import SURE, UNLIKELY, Answer, Question, Verdict, _judged
from pcretrieve.gallery.groups import GAP, near_pairs, plane_map
from pcretrieve.options import PipelineOptions, RetrievalOptions
from pcretrieve.retrieval import SignatureIndex, pairwise, table_whitening
from pcretrieve.retrieval.people import RATES, Reference
from pcretrieve.retrieval.scores import (
    MatchScores,
    Trials,
    _Pairs,
    _shares,
    features,
    fit_scores,
    fitted_coefficients,
)
from pcretrieve.values import Neighbors, SignatureTable

PLAIN = RetrievalOptions(whitening="none")


def classes(
    n_classes: int, n_each: int, seed: int, spread: float = 0.5
) -> SignatureTable:
    """Normally distributed classes, which differ most within themselves in the first direction."""
    rng, n = np.random.default_rng(seed), n_classes * n_each
    noise = spread * rng.normal(size=(n, 6)) * np.geomspace(3, 0.5, 6)
    centres = np.repeat(rng.normal(size=(n_classes, 6)), n_each, axis=0)
    return table_of(centres + noise, classes_of(n, n_each))


def scores_of(table: SignatureTable) -> MatchScores:
    found = fit_scores(table, table_whitening(table, PLAIN))
    assert found is not None
    return found


def test_a_score_is_the_share_among_new_pairs_that_near() -> None:
    found = scores_of(classes(120, 8, seed=0, spread=0.25))
    assert (
        found.reason
        == "share of pairs of one class among pairs as near, of 460320 pairs of 120 classes"
    )
    new = classes(120, 8, seed=1, spread=0.25)
    first, second = np.triu_indices(len(new), k=1)
    logs, labels = np.log(new.values), np.array(new.labels)
    given = found.of(pairwise("log", logs, logs)[first, second])
    for low in (0.05, 0.2, 0.4):
        near = (given >= low) & (given < 2 * low)
        assert near.sum() > 100
        same = labels[first[near]] == labels[second[near]]
        assert same.mean() == pytest.approx(given[near].mean(), rel=0.25)


def test_scores_descend_and_are_kept_with_an_index() -> None:
    table = classes(10, 5, seed=6)
    found = scores_of(table)
    assert (np.diff(found.scores) <= 0).all() and (np.diff(found.distances) >= 0).all()
    assert 0 < found.of(np.array([np.inf]))[0] < found.of(np.array([0.0]))[0] < 1
    with pytest.raises(InputError, match="scores must not ascend"):
        MatchScores(np.array([0.0, 1.0]), np.array([0.1, 0.2]), "")
    again = SignatureIndex.from_arrays(SignatureIndex(table, scores=found).to_arrays())
    assert again.scores == found and again.scores.reason == found.reason
    assert SignatureIndex.from_arrays(SignatureIndex(table).to_arrays()).scores is None


def test_sure_answers_are_right_and_strangers_are_told() -> None:
    """Every other class is left out of the catalogue, and every third shape is a query."""
    table = classes(20, 6, seed=1, spread=0.05)
    rows = np.arange(len(table))
    is_known, asked = rows // 6 % 2 == 1, rows % 3 == 0
    shown = np.flatnonzero(is_known & ~asked)
    found = scores_of(table.select([table.ids[row] for row in shown]))
    apart = pairwise("log", np.log(table.values[asked]), np.log(table.values[shown]))
    first = shown[apart.argmin(axis=1)] // 6
    others = np.where(first[:, np.newaxis] == shown // 6, np.inf, apart).min(axis=1)
    sure = np.array(
        [found.certainty(*pair) for pair in zip(apart.min(axis=1), others, strict=True)]
    )
    right = first == rows[asked] // 6
    assert right[sure >= SURE].all() and (sure[right] >= SURE).mean() > 0.8
    assert (sure[~is_known[asked]] < UNLIKELY).mean() > 0.8
    assert found.limit(0.001) < found.limit(0.1) < np.inf
    _, near, far = scores_of(classes(8, 6, seed=0)).coefficients
    assert (
        near <= 0 <= far
    )  # slopes with the logarithms of the distance, and of its ratio to the next class


def test_the_reach_of_a_rate_is_farther_than_that_share_of_strangers() -> None:
    """A false match is a pair of two classes that is as near, and a larger rate reaches farther."""
    table = classes(12, 6, seed=3)
    found = scores_of(table)
    logs, labels = np.log(table.values), np.array(table.labels)
    first, second = np.triu_indices(len(table), k=1)
    strangers = labels[first] != labels[second]
    apart = pairwise("log", logs, logs)[first, second][strangers]
    for rate in (0.003, 0.01, 0.1, 0.3, 0.9):
        assert (apart <= found.limit(rate)).mean() == pytest.approx(rate, rel=0.1)
    assert (found.limit(0.0), found.limit(1.0)) == pytest.approx(
        (apart.min(), apart.max())
    )


def test_two_points_have_scores_that_can_be_counted() -> None:
    """Twenty pairs of one class at a distance of 0, and 25 others: Jeffreys adds a half to both."""
    table = table_of(np.repeat([[0.0], [1.0]], 5, axis=0), classes_of(10, 5))
    near, far = scores_of(table).of(np.array([0.0, 9.0]))
    assert (near, far) == pytest.approx((20.5 / 21, 0.5 / 26), rel=1e-12)


def test_scores_need_ten_pairs_of_one_class() -> None:
    for sizes, n_pairs in (((5, 1), 10), ((3, 3, 3), 9)):
        labels = [
            f"class {number}" for number, size in enumerate(sizes) for _ in range(size)
        ]
        table = table_of(np.random.default_rng(0).normal(size=(len(labels), 3)), labels)
        assert (fit_scores(table, table_whitening(table, PLAIN)) is None) == (
            n_pairs == 9
        )


def test_a_score_is_known_for_every_five_pairs_and_at_a_hundred_distances() -> None:
    """Between pairs of one class there are ever more others, so that no two intervals are pooled."""
    for n_same, n_known in ((60, 12), (99, 19), (1000, 100)):
        ours = np.arange(n_same, dtype=np.float64)
        others = np.repeat(ours + 0.5, np.arange(n_same))
        same = np.arange(n_same + len(others)) < n_same
        pairs = _Pairs(np.append(ours, others), same, np.ones(len(same)))
        distances, scores = _shares(pairs)
        assert (
            len(distances) == len(np.unique(scores)) == n_known + 1
        )  # and behind the last


def test_a_stranger_counts_as_a_tenth_of_a_known_query() -> None:
    """All distances are 1: the first class is the answer to each query, and right for its two shapes."""
    table = table_of(np.eye(20) / np.sqrt(2), classes_of(20, 2))
    assert scores_of(table).certainty(1.0, 1.0) == pytest.approx(
        2 / (20 + 0.1 * 20), rel=1e-3
    )


def test_slopes_of_certainty_are_where_the_ridge_holds_the_likelihood() -> None:
    """The derivative of the likelihood is twice the ridge times the slope, and 0 for the constant."""
    table = classes(8, 6, seed=1, spread=0.25)
    found, logs = scores_of(table).coefficients, np.log(table.values)
    apart, labels = pairwise("log", logs, logs), np.array(table.labels)
    slope = np.zeros(3)
    for query, label in enumerate(labels):
        for weight, hidden in ((1.0, np.arange(48) == query), (0.1, labels == label)):
            row = np.where(hidden, np.inf, apart[query])
            other = row[labels != labels[row.argmin()]].min()
            features = np.array([1.0, np.log(row.min()), np.log(other / row.min())])
            is_right = labels[row.argmin()] == label
            slope += weight * (is_right - 1 / (1 + np.exp(-features @ found))) * features
    assert found[1] < 0 < found[2], "neither slope is at its bound"
    np.testing.assert_allclose(slope, 2 * 0.01 * found * [0, 1, 1], atol=1e-3)


def test_shapes_nearer_than_a_thousandth_are_equally_near() -> None:
    found = scores_of(classes(8, 6, seed=0))
    at_limit = found.certainty(0.001, 0.5)
    assert found.certainty(0.0, 0.5) == found.certainty(0.00095, 0.5) == at_limit
    assert found.certainty(0.00105, 0.5) != at_limit


def test_the_next_class_is_as_far_as_the_last_neighbour_if_none_of_them_is_of_it() -> (
    None
):
    found = scores_of(classes(20, 6, seed=1, spread=0.05))
    near, far = 0.1, 0.5
    question, answer = Question(PipelineOptions()), Answer(Neighbors((), np.zeros(0)), ())
    alone = _judged(answer, [(far, "cat"), (near, "cat")], found, question)
    assert (alone.label, alone.other) == ("cat", None)
    assert alone.certainty == found.certainty(near, far) != found.certainty(near, near)
    other = _judged(answer, [(far, "dog"), (near, "cat")], found, question)
    assert (other.label, other.other, other.certainty) == ("cat", "dog", alone.certainty)
    rare = Question(PipelineOptions(), false_match_rate=1e-9)
    assert (
        _judged(answer, [(9.0, "cat"), (9.5, "dog")], found, rare).verdict == "stranger"
    )
    assert _judged(answer, [], found, question).verdict == "unknown"


@pytest.mark.parametrize(
    ("verdict", "other", "line"),
    [
        ("sure", "bob", "ann, sure"),
        ("between", "bob", "between: ann or bob"),
        ("between", None, "between: ann"),
        ("stranger", "bob", "stranger"),
        ("unknown", "bob", "unknown: ann"),
    ],
)
def test_an_answer_is_one_line(verdict: Verdict, other: str | None, line: str) -> None:
    answer = Answer(Neighbors((), np.zeros(0)), (), verdict, "ann", other)
    assert str(answer) == line


@pytest.mark.parametrize("n", [1, 2, 50, 1200])
def test_near_pairs_are_those_of_all_pairs(n: int) -> None:
    logs = np.random.default_rng(n).normal(size=(n, 3))
    logs[: n // 10] = logs[0]
    index = SignatureIndex(table_of(logs), PLAIN)
    found = near_pairs(index, 0.1)
    distances = pairwise("log", logs, logs)
    first, second = np.nonzero(np.triu(distances <= 0.1, k=1))
    pairs = sorted((int(pair.first[1:]), int(pair.second[1:])) for pair in found)
    assert pairs == list(zip(first.tolist(), second.tolist(), strict=True))
    expected = np.sort(distances[first, second])
    np.testing.assert_allclose([pair.distance for pair in found], expected, rtol=1e-12)


def test_a_map_keeps_neighbours_and_hides_none() -> None:
    labels = np.repeat(np.arange(8), 10)
    index = SignatureIndex(classes(8, 10, seed=0, spread=0.02), PLAIN)
    places = plane_map(index.points)
    assert places.min() >= 0 and places.max() <= 1
    np.testing.assert_allclose(np.ptp(places, axis=0).max(), 1)
    apart = cdist(places, places) + 9 * np.eye(80)
    assert (labels[apart.argmin(axis=1)] == labels).all()
    assert apart.min() > 0.5 * GAP
    np.testing.assert_array_equal(plane_map(index.points), places)


# --- beside a reference -------------------------------------------------------------------------------------


def reference_of(table: SignatureTable) -> Reference:
    """What distances in a table mean, each shape a query in one other shape of each class."""
    logs, labels = np.log(table.values), np.array(table.labels)
    apart = pairwise("log", logs, logs)
    first, second = np.triu_indices(len(table), k=1)
    same = labels[first] == labels[second]
    pairs = apart[first, second]
    rng, found = np.random.default_rng(0), []
    for row, label in enumerate(labels):
        for is_absent in (False, True):
            drawn = [
                rng.choice(
                    np.flatnonzero((labels == name) & (np.arange(len(table)) != row))
                )
                for name in np.unique(labels)
                if name != label or not is_absent
            ]
            near = np.sort(apart[row, drawn])[:2]
            nearest = drawn[int(apart[row, drawn].argmin())]
            found.append((*near, labels[nearest] == label))
    near, other, right = np.array(found).T
    trials = Trials(features(near, other), right.astype(bool), np.ones(len(near)))
    coefficients = fitted_coefficients(trials)
    share = 1 / (1 + np.exp(-trials.features @ coefficients))
    information = (trials.features.T * (share * (1 - share))) @ trials.features
    return Reference(
        np.quantile(pairs[same], np.linspace(0, 1, 101)),
        np.quantile(pairs[~same], RATES),
        coefficients,
        information / len(near),
    )


def test_one_shape_of_each_class_is_answered_by_a_reference() -> None:
    """The nearest is right, somebody else is a stranger, and no pair of the table says so."""
    known = reference_of(classes(40, 5, seed=7, spread=0.06))
    table = classes(12, 2, seed=8, spread=0.06)
    rows = np.arange(len(table))
    shown = np.flatnonzero((rows % 2 == 0) & (rows < 16))
    stored = table.select([table.ids[row] for row in shown])
    assert fit_scores(stored, table_whitening(stored, PLAIN)) is None
    found = fit_scores(stored, table_whitening(stored, PLAIN), reference=known)
    assert found is not None and "simulated people" in found.reason
    asked = np.flatnonzero(rows % 2 == 1)
    apart = pairwise("log", np.log(table.values[asked]), np.log(stored.values))
    near = np.sort(apart, axis=1)[:, :2]
    certain = np.array([found.certainty(*pair) for pair in near])
    is_known = asked < 16
    assert (certain[is_known] >= SURE).mean() > 0.8
    assert (certain[~is_known] < UNLIKELY).all()
    assert found.of(near[is_known, 0]).min() > found.of(near[~is_known, 0]).max()
    assert found.limit(1e-3) == pytest.approx(known.apart[RATES >= 1e-3][0], rel=0.1)


def test_a_large_collection_hardly_hears_the_reference() -> None:
    """That of other classes, which are much more compact, moves the statistics of many shapes little."""
    table = classes(100, 8, seed=9, spread=0.3)
    own = scores_of(table)
    known = reference_of(classes(30, 5, seed=7, spread=0.02))
    found = fit_scores(table, table_whitening(table, PLAIN), reference=known)
    assert found is not None
    near = np.linspace(0.5, 3, 6)
    assert found.of(near) == pytest.approx(own.of(near), abs=0.03)
    assert found.limit(0.01) == pytest.approx(own.limit(0.01), rel=0.05)
    assert found.certainty(0.6, 2.0) == pytest.approx(own.certainty(0.6, 2.0), abs=0.1)


def test_strangers_count_only_beside_queries_that_can_be_found() -> None:
    """One class of two shapes among many of one: a tenth of two queries, not of all, are of nobody."""
    labels = ["twin", "twin", *(f"single {number}" for number in range(30))]
    table = table_of(np.random.default_rng(0).normal(size=(32, 4)), labels)
    known = reference_of(classes(30, 5, seed=7, spread=0.1))
    found = fit_scores(table, table_whitening(table, PLAIN), reference=known)
    assert found is not None
    assert found.coefficients == pytest.approx(known.coefficients, rel=0.1)
