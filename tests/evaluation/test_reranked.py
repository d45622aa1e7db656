"""Evaluation with re-ranking: the protocol, and that it looks at no labels."""

import numpy as np
import pytest

from pcretrieve.evaluation import evaluate_table, rank_table, rerank_table
from pcretrieve.evaluation.folds import Subset, rank_subsets, within_class_folds, within_class_subsets
from pcretrieve.options import RetrievalOptions
from pcretrieve.retrieval import DistanceBlock, pairwise, rerank
from pcretrieve.retrieval.reranking import neighbour_lists
from pcretrieve.values import SignatureTable


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


def test_the_gallery_has_no_class_to_which_the_whitening_was_fitted() -> None:
    """These classes are dense after the whitening, which would make the others look isolated."""
    table = a_table()
    options = RetrievalOptions(whitening="within-class", rerank="local")
    folds = list(within_class_folds(table, options))
    assert len(folds) == options.n_folds
    for fold, subset in zip(folds, within_class_subsets(table, options), strict=True):
        np.testing.assert_array_equal(subset.members, fold.queries)
        whitened = fold.whitening.apply(np.log(table.values[subset.members]))
        for queries, distances in subset.blocks:
            np.testing.assert_array_equal(distances, pairwise("log", whitened[queries], whitened))


@pytest.mark.parametrize("whitening", ["none", "within-class"])
def test_several_methods_at_once_rank_as_each_of_them(whitening: str) -> None:
    table = a_table()
    options = RetrievalOptions(whitening=whitening)
    found = rerank_table(table, ("none", "local", "k-reciprocal"), options)
    for method in ("local", "k-reciprocal"):
        assert found[method] == rank_table(table, options.model_copy(update={"rerank": method}))
        assert found[method] != found["none"]


def test_ranks_are_those_of_the_re_ranked_lists_and_then_of_the_distances() -> None:
    """Over more shapes than are sorted again, with many equal distances, and some shapes without a class."""
    rng = np.random.default_rng(4)
    n = 150
    distances = np.round(rng.random((n, n)), 1)
    ids = [f"{number:03}" for number in range(n)]
    labels = [None if number % 10 == 0 else f"class {number % 7}" for number in range(n)]
    block = DistanceBlock(np.arange(n), distances)
    found = rank_subsets([Subset(np.arange(n), [block])], ids, labels, ("none", "local"))
    again = rerank("local", neighbour_lists([block], n))
    for number, query in enumerate(map(int, found["local"].ids)):
        order = list(again[query])
        rest = sorted(set(range(n)).difference(order), key=lambda other: (distances[query, other], other))
        ranked = [labels[other] == labels[query] for other in order + rest]
        expected = np.flatnonzero(ranked)[1:]
        np.testing.assert_array_equal(found["local"].hit_rank[found["local"].hit_query == number], expected)
