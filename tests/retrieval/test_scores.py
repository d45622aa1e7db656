"""Scores are true of shapes that were not counted; sure answers, near pairs, and maps."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.distance import cdist
from tables import classes_of, table_of

from pcretrieve.errors import InputError
from pcretrieve.options import RetrievalOptions
from pcretrieve.query import SURE, UNLIKELY, Match
from pcretrieve.retrieval import SignatureIndex, pairwise, table_whitening
from pcretrieve.retrieval.clusters import GAP, near_pairs, plane_map
from pcretrieve.retrieval.scores import MatchScores, fit_scores
from pcretrieve.values import SignatureTable

PLAIN = RetrievalOptions(whitening="none")


def classes(n_classes: int, n_each: int, seed: int, spread: float = 0.5) -> SignatureTable:
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
    sure = np.array([found.sureness(*pair) for pair in zip(apart.min(axis=1), others, strict=True)])
    right = first == rows[asked] // 6
    assert right[sure >= SURE].all() and (sure[right] >= SURE).mean() > 0.8
    assert (sure[~is_known[asked]] < UNLIKELY).mean() > 0.8
    assert found.reach(0.001) < found.reach(0.1) < np.inf
    _, near, far = scores_of(classes(8, 6, seed=0)).certainty
    assert (
        near <= 0 <= far
    )  # slopes with the logarithms of the distance, and of its ratio to the next class


def test_an_answer_is_one_line() -> None:
    for match, line in (
        (Match("ann", "bob", 0.99), "ann, sure"),
        (Match("ann", "bob", 0.7), "ann or bob"),
        (Match("ann", None, 0.7), "ann, not sure"),
        (Match("ann", "bob", 0.1), "not in this collection; the nearest class is ann"),
        (Match("ann", "bob", None), "nearest class ann"),
    ):
        assert str(match) == line


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
