"""Grouped folds separate classes, an evaluation uses them, re-ranking looks at no labels, and "no match"."""

import math
from dataclasses import asdict, replace

import numpy as np
import pytest
from benchmarks.measuring import evaluate_table
from benchmarks.retrieval import no_match_measures
from tables import classes_of, posed_logs, table_of

from pcretrieve.errors import BenchmarkError
from pcretrieve.evaluation import rank_table
from pcretrieve.evaluation.rankings import (
    Subset,
    grouped_folds,
    rank_subsets,
    within_class_folds,
    within_class_subsets,
)
from pcretrieve.options import RetrievalOptions
from pcretrieve.retrieval import (
    DISTANCES,
    DistanceBlock,
    coordinates,
    fit_whitening,
    pairwise,
)
from pcretrieve.retrieval.reranking import NeighbourLists, rerank
from pcretrieve.values import SignatureTable

WITHIN_CLASS = RetrievalOptions(whitening="within-class")
PLAIN = RetrievalOptions(whitening="none")


def a_table() -> SignatureTable:
    """Ten classes of six: the spread within classes hides that between them."""
    return table_of(posed_logs(), classes_of(60, 6))


def round_classes(noise: float = 0.35) -> SignatureTable:
    """Twenty classes of six, with the same spread in all directions."""
    rng = np.random.default_rng(0)
    centres = np.repeat(rng.normal(size=(20, 8)), 6, axis=0)
    return table_of(centres + noise * rng.normal(size=(120, 8)), classes_of(120, 6))


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


def test_the_whitening_of_a_fold_is_that_of_the_other_folds() -> None:
    table = a_table()
    logs = coordinates(table.values)
    folds = list(within_class_folds(table, RetrievalOptions(shrinkage=0.2)))
    assert len(folds) == 5
    for queries, whitening in folds:
        others = np.setdiff1d(np.arange(60), queries)
        labels = [table.labels[row] for row in others]
        expected = fit_whitening("within-class", logs[others], labels, shrinkage=0.2)
        np.testing.assert_allclose(whitening.matrix, expected.matrix, rtol=1e-12)
        np.testing.assert_allclose(whitening.mean, expected.mean, rtol=1e-12)
        assert whitening.options_digest == "3f2a"


@pytest.mark.parametrize("distance", DISTANCES)
def test_queries_are_ranked_against_the_whole_gallery_or_re_ranked_in_their_fold(
    distance: str,
) -> None:
    """Shapes of a fit are dense, and would make others look isolated. A shape without label is no query."""
    table = a_table()
    values = np.vstack([table.values, np.full(8, 50.0)])
    table = replace(
        table, ids=(*table.ids, "stranger"), values=values, labels=(*table.labels, None)
    )
    options, logs = RetrievalOptions(distance=distance), coordinates(table.values)
    seen = []
    for among_fold in (False, True):
        subsets = within_class_subsets(table, options, among_fold=among_fold)
        for (queries, whitening), subset in zip(
            within_class_folds(table, options), subsets, strict=True
        ):
            seen += queries.tolist()
            members = queries if among_fold else np.arange(61)
            np.testing.assert_array_equal(subset.members, members)
            for rows, distances in subset.blocks:
                np.testing.assert_array_equal(members[rows], queries)
                points = whitening.apply(logs[members])
                assert (distances == pairwise(distance, points[rows], points)).all()
    assert sorted(seen) == sorted([*range(60)] * 2)


@pytest.mark.parametrize("whitening", ["none", "pca", "within-class"])
@pytest.mark.parametrize("distance", DISTANCES)
def test_an_evaluation_whitens_the_gallery_in_any_order(
    distance: str, whitening: str
) -> None:
    table = a_table()
    options = RetrievalOptions(distance=distance, whitening=whitening)
    shuffled = table.select(
        [table.ids[i] for i in np.random.default_rng(5).permutation(60)]
    )
    measured = asdict(evaluate_table(table, options))
    assert asdict(evaluate_table(shuffled, options)) == pytest.approx(measured)
    if whitening == "within-class":
        subsets = list(within_class_subsets(table, options, among_fold=False))
    else:
        points = fit_whitening(whitening, logs := coordinates(table.values)).apply(logs)
        block = DistanceBlock(np.arange(60), pairwise(distance, points, points))
        subsets = [Subset(np.arange(60), [block])]
    assert rank_table(table, options) == rank_subsets(subsets, table.ids, table.labels)


# --- re-ranking -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("whitening", ["none", "neighbours", "pca", "within-class"])
def test_re_ranking_keeps_the_nearest_shape_and_gives_the_plain_rankings_too(
    whitening: str,
) -> None:
    table = round_classes()
    options = RetrievalOptions(whitening=whitening, rerank="k-reciprocal")
    again, plain = rank_table(table, options)
    assert (
        plain in rank_table(table, PLAIN.model_copy(update={"whitening": whitening}))
        or whitening == "within-class"
    )
    assert again.hit_rank.tolist() != plain.hit_rank.tolist()
    assert again.nearest == plain.nearest


def test_overlapping_classes_are_ranked_better() -> None:
    table = round_classes(noise=0.45)
    plain = evaluate_table(table, PLAIN)
    again = evaluate_table(
        table, RetrievalOptions(whitening="none", rerank="k-reciprocal")
    )
    assert plain.map < 0.9
    assert again.map > plain.map + 0.03


def test_ranks_are_those_of_the_re_ranked_lists_and_then_of_the_distances() -> None:
    """Over more shapes than are sorted again, with many equal distances, and some shapes without a class."""
    rng = np.random.default_rng(4)
    n = 150
    distances = np.round(rng.random((n, n)), 1)
    ids = [f"{number:03}" for number in range(n)]
    labels = [None if number % 10 == 0 else f"class {number % 7}" for number in range(n)]
    block = DistanceBlock(np.arange(n), distances)
    found = rank_subsets([Subset(np.arange(n), [block])], ids, labels, again=True)[0]
    own_first = np.where(np.eye(n, dtype=bool), -1, distances)
    nearest = np.argsort(own_first, axis=1, kind="stable")[:, :101]
    again = rerank(
        NeighbourLists(nearest, np.take_along_axis(distances, nearest, axis=1))
    )
    for number, query in enumerate(map(int, found.ids)):
        order = list(again[query])
        rest = sorted(
            set(range(n)).difference(order),
            key=lambda other: (distances[query, other], other),
        )
        ranked = [labels[other] == labels[query] for other in order + rest]
        expected = np.flatnonzero(ranked)[1:]
        np.testing.assert_array_equal(found.hit_rank[found.hit_query == number], expected)


# --- classes that are not in the gallery ----------------------------------------------------------------


@pytest.mark.parametrize("labelled", [True, False])
def test_of_distinct_classes_all_answers_are_right(labelled: bool) -> None:
    found = no_match_measures(round_classes(1e-3), labelled=labelled)
    assert (found.precision, found.recall, found.matched, found.right) == (1, 1, 1, 1)
    assert found.n_queries == 10 * 20 * 2
    assert ("within-class" in found.whitening) == labelled


def test_of_classes_without_differences_there_is_no_match() -> None:
    """The least score is then never reached, and half of the queries are of classes in the gallery."""
    found = no_match_measures(round_classes(50.0), PLAIN)
    assert (found.matched, found.recall) == (0, 1)
    assert found.precision == pytest.approx(0.5)
    assert math.isnan(found.right)
    lax = no_match_measures(round_classes(50.0), PLAIN, min_score=0)
    assert (lax.matched, lax.recall) == (1, 0)
    assert math.isnan(lax.precision)
    assert lax.right < 0.5
    alone = replace(round_classes(), labels=("one",) * 6 + (None,) * 114)
    with pytest.raises(BenchmarkError, match="two classes of 3 shapes or more, got 1"):
        no_match_measures(alone)
