"""Evaluation with re-ranking: the protocol, and that it looks at no labels."""

from dataclasses import replace

import numpy as np
import pytest

from pcretrieve.evaluation import evaluate_table, rank_table
from pcretrieve.evaluation.folds import within_class_distances, within_class_folds
from pcretrieve.options import RetrievalOptions
from pcretrieve.types import SignatureTable


def a_table(n_classes: int = 20, per_class: int = 6, *, noise: float = 0.35) -> SignatureTable:
    rng = np.random.default_rng(0)
    centres = np.repeat(rng.normal(size=(n_classes, 8)), per_class, axis=0)
    n = n_classes * per_class
    values = np.exp(centres + noise * rng.normal(size=(n, 8)))
    labels = tuple(f"class {row // per_class}" for row in range(n))
    return SignatureTable(tuple(f"{row:04}" for row in range(n)), values, "x", labels=labels)


@pytest.mark.parametrize("whitening", ["none", "neighbours", "pca"])
def test_the_nearest_shape_stays(whitening: str) -> None:
    table = a_table()
    for method in ("local", "k-reciprocal"):
        plain = evaluate_table(table, RetrievalOptions(whitening=whitening))
        again = evaluate_table(table, RetrievalOptions(whitening=whitening, rerank=method))
        assert again.nn == plain.nn
        assert again.map != plain.map


def test_overlapping_classes_are_ranked_better() -> None:
    table = a_table(noise=0.45)
    plain = evaluate_table(table, RetrievalOptions(whitening="none"))
    again = evaluate_table(table, RetrievalOptions(whitening="none", rerank="k-reciprocal"))
    assert plain.map < 0.9
    assert again.map > plain.map + 0.03


def test_lists_are_not_sorted_by_labels() -> None:
    table = a_table()
    rng = np.random.default_rng(1)
    options = RetrievalOptions(rerank="k-reciprocal")
    for _ in range(3):
        shuffled = replace(table, labels=tuple(rng.permutation(np.array(table.labels)).tolist()))
        assert evaluate_table(shuffled, options).map < 0.15


def test_the_gallery_has_no_class_to_which_the_whitening_was_fitted() -> None:
    """These classes are dense after the whitening, which would make the others look isolated."""
    table = a_table()
    options = RetrievalOptions(whitening="within-class", rerank="local")
    fold_of = np.zeros(len(table), dtype=int)
    for number, fold in enumerate(within_class_folds(table, options)):
        fold_of[fold.queries] = number
    for queries, ranks in within_class_distances(table, options, unseen_only=True):
        np.testing.assert_array_equal(np.isfinite(ranks), fold_of[queries][:, np.newaxis] == fold_of)


def test_noise_stays_noise_after_a_fitted_whitening_and_re_ranking() -> None:
    rng = np.random.default_rng(3)
    table = a_table()
    options = RetrievalOptions(whitening="within-class", rerank="k-reciprocal")
    plain = RetrievalOptions(whitening="within-class")
    gains = []
    for _ in range(5):
        noise = replace(table, values=rng.lognormal(size=table.values.shape))
        before = rank_table(noise, plain, unseen_only=True)
        after = rank_table(noise, options)
        gains.append(np.mean(1 / after.hit_rank) - np.mean(1 / before.hit_rank))
    assert abs(np.mean(gains)) < 0.02
