"""Intervals of the bootstrap: their coverage, their agreement with scipy, and their pairs."""

import numpy as np
from scipy.stats import bootstrap

from pcretrieve.evaluation import bootstrap_interval


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


def test_it_covers_the_true_mean_as_often_as_it_says() -> None:
    rng = np.random.default_rng(1)
    covered = []
    for _ in range(200):
        low, high = bootstrap_interval(rng.random((60, 1)), level=0.8, rng=rng)
        covered.append(low[0] <= 0.5 <= high[0])
    assert 0.72 < np.mean(covered) < 0.88


def test_columns_of_a_row_are_drawn_together() -> None:
    """The interval of a difference of two columns that differ by a constant is a point."""
    easy = np.random.default_rng(3).random(50)
    low, high = bootstrap_interval(np.column_stack([easy, easy + 0.1, np.full(50, 0.1)]))
    np.testing.assert_allclose(low[1] - low[0], 0.1)
    np.testing.assert_allclose([low[2], high[2]], 0.1)
    assert high[0] - low[0] > 0.1
