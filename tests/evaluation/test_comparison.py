"""Intervals of the bootstrap, two results for the same queries, and what cannot be compared."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import bootstrap

from pcretrieve.errors import InputError
from pcretrieve.evaluation.comparison import compare_scores
from pcretrieve.evaluation.measures import QueryScores, bootstrap_interval
from pcretrieve.values import FloatArray


def scores(ap: FloatArray, *, start: int = 0) -> QueryScores:
    """Measures that are all equal, of queries with consecutive names."""
    ids = tuple(f"{start + number:03}" for number in range(len(ap)))
    return QueryScores(ids, ("X",) * len(ap), ap, ap, ap, ap, ap, ap)


EASE = np.random.default_rng(0).random(100)


def test_small_differences_show_beside_large_ones_between_queries() -> None:
    """The measures of a result vary by .3 from query to query, their differences by .005."""
    gains = 0.005 + 0.005 * np.random.default_rng(1).normal(size=100)
    first, second = scores(0.9 * EASE), scores(0.9 * EASE + np.abs(gains))
    found = compare_scores(first, second)
    np.testing.assert_allclose(found.difference, np.abs(gains).mean())
    assert (found.interval[0] > 0).all()
    low, high = bootstrap_interval(first.columns)
    assert (high - low > 10 * (found.interval[1] - found.interval[0])).all()
    reverse = compare_scores(second, first)
    np.testing.assert_allclose(reverse.interval, -found.interval[::-1])
    np.testing.assert_allclose(reverse.difference, -found.difference)


def test_queries_are_matched_by_their_ids() -> None:
    """The largest changes come first; queries that one result lacks are left out and named."""
    order = np.random.default_rng(2).permutation(100)
    changed = EASE / 2 + 0.25
    shuffled = replace(scores(changed[order]), ids=tuple(f"{row:03}" for row in order))
    found = compare_scores(scores(EASE), shuffled)
    np.testing.assert_allclose(found.difference, (changed - EASE).mean())
    steps = [abs(one.second - one.first) for one in found.changes]
    assert steps == sorted(steps, reverse=True)
    assert len(steps) == 100
    row = int(np.argmax(np.abs(changed - EASE)))
    assert found.changes[0] == (f"{row:03}", "X", EASE[row], changed[row])
    some = compare_scores(scores(EASE[:60]), scores(EASE[10:], start=10))
    assert some.only_first == tuple(f"{number:03}" for number in range(10))
    assert some.only_second == tuple(f"{number:03}" for number in range(60, 100))
    np.testing.assert_allclose([some.first, some.second], EASE[10:60].mean())


def test_results_of_other_shapes_or_classes() -> None:
    with pytest.raises(InputError, match="must have queries in common, got none of 100 and 100"):
        compare_scores(scores(EASE), scores(EASE, start=500))
    other = replace(scores(EASE), labels=("X",) * 98 + ("Y", "Z"))
    with pytest.raises(InputError, match="the same class in both results, 2 have another, such as 098, 099"):
        compare_scores(scores(EASE), other)


# --- intervals ----------------------------------------------------------------------------------------------


def test_the_interval_agrees_with_that_of_scipy() -> None:
    values = np.random.default_rng(0).beta(5, 1, size=(200, 2))
    low, high = bootstrap_interval(values, level=0.9)
    for column in range(2):
        expected = bootstrap(
            (values[:, column],), np.mean, confidence_level=0.9, method="percentile", rng=1
        ).confidence_interval
        width = expected.high - expected.low
        assert abs(low[column] - expected.low) < 0.1 * width
        assert abs(high[column] - expected.high) < 0.1 * width


def test_columns_of_a_row_are_drawn_together() -> None:
    """The interval of a difference of two columns that differ by a constant is a point."""
    easy = np.random.default_rng(3).random(50)
    low, high = bootstrap_interval(np.column_stack([easy, easy + 0.1, np.full(50, 0.1)]))
    np.testing.assert_allclose(low[1] - low[0], 0.1)
    np.testing.assert_allclose([low[2], high[2]], 0.1)
    assert high[0] - low[0] > 0.1
