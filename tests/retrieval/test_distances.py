"""Distances and coordinates: the paper's formulas, metric laws, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from pcretrieve.errors import InputError, OptionError
from pcretrieve.retrieval import DISTANCES, coordinates, pairwise
from pcretrieve.values import FloatArray, Metric


def some_values(n: int, *, seed: int = 0, n_values: int = 23, spread: float = 1.0) -> FloatArray:
    """(n, n_values) positive numbers over several orders of magnitude."""
    return np.exp(spread * np.random.default_rng(seed).normal(-4, 1, (n, n_values)))


LITERAL: dict[str, Callable[[FloatArray, FloatArray], Any]] = {
    "d1": lambda a, b: np.sum(np.abs((a - b) / (a + b))),
    "d2": lambda a, b: np.sqrt(np.sum((a - b) ** 2 / (a * b))),
    "log": lambda a, b: np.linalg.norm(np.log(a / b)),
}


@pytest.mark.parametrize("distance", DISTANCES)
def test_is_the_printed_formula_and_exact_for_each_pair(distance: str) -> None:
    """A pair depends neither on its company nor on its order, to the last bit, nor on a common factor."""
    a, b, factor = some_values(8), some_values(5, seed=1), some_values(1, seed=2)
    found = pairwise(distance, coordinates(a), coordinates(b))
    np.testing.assert_allclose(found, [[LITERAL[distance](p, q) for q in b] for p in a], rtol=1e-12)
    scaled = pairwise(distance, coordinates(a * factor), coordinates(b * factor))
    np.testing.assert_allclose(scaled, found, rtol=1e-10)
    gallery = coordinates(some_values(9000, n_values=31))  # more than one chunk
    queries = gallery[[0, 5000, 8999]]
    together = pairwise(distance, queries, gallery)
    assert (together[1] == pairwise(distance, queries[1:2], gallery)[0]).all()
    assert (together[:, 8999] == pairwise(distance, gallery[8999:], queries)[0]).all()
    assert (together[[0, 1, 2], [0, 5000, 8999]] == 0).all()
    assert pairwise(distance, np.zeros((0, 3)), np.zeros((4, 3))).shape == (0, 4)
    assert pairwise(distance, np.zeros((4, 3)), np.zeros((0, 3))).shape == (4, 0)


def test_hand_worked() -> None:
    a, b = coordinates([[1.0, 1.0]]), coordinates([[4.0, 1.0]])
    assert pairwise("d1", a, b)[0, 0] == pytest.approx(3 / 5)
    assert pairwise("d2", a, b)[0, 0] == pytest.approx(np.sqrt(9 / 4))
    assert pairwise("log", a, b)[0, 0] == pytest.approx(np.log(4))
    assert pairwise("d1", np.zeros((1, 7)), np.full((1, 7), 1000.0))[0, 0] == 7
    assert pairwise("d2", np.array([[-720.0]]), np.array([[720.0]]))[0, 0] == np.inf


def test_metric_laws() -> None:
    logs = coordinates(some_values(30, spread=2.0))
    for distance in ("d1", "log"):
        d = pairwise(distance, logs, logs)
        assert (d <= (d[:, :, np.newaxis] + d[np.newaxis, :, :]).min(axis=1) + 1e-12).all()
    line = coordinates([[1.0], [10.0], [100.0]])
    d = pairwise("d2", line, line)
    assert d[0, 2] > d[0, 1] + d[1, 2], "d2 is no metric"
    assert (pairwise("log", logs, logs) <= pairwise("d2", logs, logs) * (1 + 1e-14)).all()


def test_what_has_no_distance_or_no_coordinates() -> None:
    with pytest.raises(OptionError, match="there is no distance 'D2'; there are log, d1, d2"):
        pairwise("D2", np.zeros((1, 3)), np.zeros((1, 3)))
    metric: Metric
    for values, metric, message in (
        ([0.5, 0.0, 0.25], "logarithms", r"must be positive and finite, got 0.0 \(1 such values of 3\)"),
        ([-1.0], "logarithms", "must be positive and finite, got -1.0"),
        ([np.nan], "logarithms", "must be positive and finite, got nan"),
        ([1.0, np.inf], "values", "signature values must be finite, got inf"),
        ([1.0, -1.0], "histograms", r"must be bins of a histogram, not negative, got -1.0 \(1 such"),
        ("bunny", "logarithms", "must be an array of numbers, got 'bunny'"),
    ):
        with pytest.raises(InputError, match=message):
            coordinates(values, metric)
