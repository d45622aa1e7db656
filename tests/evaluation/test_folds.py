"""Grouped folds separate classes, and an evaluation uses them."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from pcretrieve.evaluation.folds import (
    evaluate_table,
    grouped_folds,
    rank_table,
    within_class_distances,
    within_class_folds,
)
from pcretrieve.evaluation.measures import evaluate_rankings
from pcretrieve.evaluation.rankings import rank_gallery
from pcretrieve.options import RetrievalOptions
from pcretrieve.retrieval import DISTANCES, DistanceBlock, coordinates, fit_whitening, pairwise
from pcretrieve.values import FloatArray, SignatureTable

WITHIN_CLASS = RetrievalOptions(whitening="within-class")
PLAIN = RetrievalOptions(whitening="none")


def a_table(*, seed: int = 0, n_classes: int = 10, per_class: int = 6, n_values: int = 8) -> SignatureTable:
    """Classes that differ where poses do not: the spread within classes hides that between them."""
    rng = np.random.default_rng(seed)
    centres = rng.normal(size=(n_classes, n_values)) * np.geomspace(0.3, 0.02, n_values)
    poses = rng.normal(size=(n_classes * per_class, n_values)) * np.geomspace(0.02, 1.0, n_values)
    values = np.exp(np.repeat(centres, per_class, axis=0) + poses - 3)
    labels = [f"class {number}" for number in range(n_classes) for _ in range(per_class)]
    return SignatureTable(
        tuple(f"T{i:02}" for i in range(len(values))), values, "r-bihdm", "3f2a", tuple(labels)
    )


def distance_matrix(table: SignatureTable, distance: str) -> FloatArray:
    """(N, N) with NaN where no query was made."""
    matrix = np.full((len(table), len(table)), np.nan)
    for queries, distances in within_class_distances(table, RetrievalOptions(distance=distance)):
        matrix[queries] = distances
    return matrix


def test_every_class_is_in_one_fold_whatever_the_order_of_shapes() -> None:
    """Classes of one are spread beside the others."""
    labels = [f"class {number % 13}" for number in range(50)]
    folds = grouped_folds(labels, WITHIN_CLASS)
    assert sorted(name for fold in folds for name in fold) == sorted(set(labels))
    assert sorted(len(fold) for fold in folds) == [2, 2, 3, 3, 3]
    assert folds == grouped_folds(labels[::-1], WITHIN_CLASS)
    folds = grouped_folds([*"aabbccddeeffgghhiijj", *"uvwxy", None], WITHIN_CLASS)
    assert [sum(name in "abcdefghij" for name in fold) for fold in folds] == [2] * 5
    assert [sum(name in "uvwxy" for name in fold) for fold in folds] == [1] * 5


def test_the_whitening_has_seen_no_value_of_the_classes_it_is_scored_on() -> None:
    table = a_table()
    poison = np.random.default_rng(7)
    folds = list(within_class_folds(table, WITHIN_CLASS))
    for number, fold in enumerate(folds):
        values = table.values.copy()
        values[fold.queries] = poison.lognormal(0, 5, values[fold.queries].shape)
        poisoned = list(within_class_folds(replace(table, values=values), WITHIN_CLASS))
        assert (poisoned[number].queries == fold.queries).all()
        assert (poisoned[number].whitening.matrix == fold.whitening.matrix).all()
        assert (poisoned[number].whitening.mean == fold.whitening.mean).all()
        # All other folds are fitted on these values, so that the changed values did affect these fits.
        for other in range(5):
            same = (poisoned[other].whitening.matrix == folds[other].whitening.matrix).all()
            assert same == (other == number)


def test_the_whitening_of_a_fold_is_that_of_the_other_folds() -> None:
    table = a_table()
    logs = coordinates(table.values)
    for fold in within_class_folds(table, RetrievalOptions(shrinkage=0.2)):
        others = np.setdiff1d(np.arange(60), fold.queries)
        expected = fit_whitening(
            "within-class", logs[others], [table.labels[i] for i in others], shrinkage=0.2
        )
        np.testing.assert_allclose(fold.whitening.matrix, expected.matrix, rtol=1e-12)
        assert fold.whitening.options_digest == "3f2a"


def test_queries_are_ranked_against_the_whole_gallery() -> None:
    table = a_table()
    logs = coordinates(table.values)
    for distance in DISTANCES:
        matrix = distance_matrix(table, distance)
        for fold in within_class_folds(table, WITHIN_CLASS):
            whitened = fold.whitening.apply(logs)
            assert (matrix[fold.queries] == pairwise(distance, whitened[fold.queries], whitened)).all()


def test_unlabelled_shapes_are_ranked_but_not_fitted_on() -> None:
    table = a_table()
    values = np.vstack([table.values, np.full(8, 50.0)])
    stranger = replace(table, ids=(*table.ids, "stranger"), values=values, labels=(*table.labels, None))
    alone, among = distance_matrix(table, "log"), distance_matrix(stranger, "log")
    assert among.shape == (61, 61)
    assert (among[:60, :60] == alone).all()
    assert np.isnan(among[60]).all()


def test_within_class_whitening_finds_nothing_in_noise() -> None:
    """Where labels mean nothing, only a whitening that has seen the scored classes seems to help."""
    rng = np.random.default_rng(3)
    table = a_table()
    honest, leaking = [], []
    shrunk_little = RetrievalOptions(whitening="within-class", shrinkage=0.01)
    for _ in range(10):
        values = rng.lognormal(size=(60, 30))
        noise = replace(table, values=values)
        logs = coordinates(values)
        seen = fit_whitening("within-class", logs, table.labels, shrinkage=0.01).apply(logs)
        baseline = evaluate_table(noise, PLAIN).map
        honest.append(evaluate_table(noise, shrunk_little).map - baseline)
        leaking.append(evaluate_table(replace(noise, values=np.exp(seen)), PLAIN).map - baseline)
    assert np.mean(honest) < 0
    assert np.mean(leaking) > 0.1


@pytest.mark.parametrize("whitening", ["none", "pca", "within-class"])
def test_evaluation_does_not_depend_on_the_order_of_shapes(whitening: str) -> None:
    table = a_table()
    shuffled = table.select([table.ids[i] for i in np.random.default_rng(5).permutation(60)])
    assert asdict(evaluate_table(shuffled, RetrievalOptions(whitening=whitening))) == pytest.approx(
        asdict(evaluate_table(table, RetrievalOptions(whitening=whitening)))
    )


@pytest.mark.parametrize("whitening", ["none", "pca"])
@pytest.mark.parametrize("distance", DISTANCES)
def test_whitening_without_labels_is_fitted_on_the_whole_gallery(distance: str, whitening: str) -> None:
    table = a_table()
    logs = coordinates(table.values)
    whitened = fit_whitening(whitening, logs).apply(logs)
    block = DistanceBlock(np.arange(60), pairwise(distance, whitened, whitened))
    expected = rank_gallery([block], table.ids, table.labels)
    options = RetrievalOptions(distance=distance, whitening=whitening)
    assert rank_table(table, options) == expected
    assert evaluate_table(table, options) == evaluate_rankings(expected)
