"""Distances: the paper's formulas, metric laws, bounds."""

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from pcretrieve.errors import InputError, OptionError
from pcretrieve.retrieval import DISTANCES, log_signatures, pairwise
from pcretrieve.values import FloatArray


def some_values(n: int, *, seed: int = 0, n_values: int = 23, spread: float = 1.0) -> FloatArray:
    """(n, n_values) positive numbers over several orders of magnitude."""
    return np.exp(spread * np.random.default_rng(seed).normal(-4, 1, (n, n_values)))


LITERAL: dict[str, Callable[[FloatArray, FloatArray], Any]] = {
    "d1": lambda a, b: np.sum(np.abs((a - b) / (a + b))),
    "d2": lambda a, b: np.sqrt(np.sum((a - b) ** 2 / (a * b))),
    "log": lambda a, b: np.linalg.norm(np.log(a / b)),
}


@pytest.mark.parametrize("distance", LITERAL)
def test_is_the_printed_formula(distance: str) -> None:
    a, b = some_values(8), some_values(5, seed=1)
    expected = [[LITERAL[distance](p, q) for q in b] for p in a]
    np.testing.assert_allclose(pairwise(distance, log_signatures(a), log_signatures(b)), expected, rtol=1e-12)


def test_hand_worked() -> None:
    a, b = log_signatures([[1.0, 1.0]]), log_signatures([[4.0, 1.0]])
    assert pairwise("d1", a, b)[0, 0] == pytest.approx(3 / 5)
    assert pairwise("d2", a, b)[0, 0] == pytest.approx(np.sqrt(9 / 4))
    assert pairwise("log", a, b)[0, 0] == pytest.approx(np.log(4))


def test_the_table_names_every_distance() -> None:
    assert set(DISTANCES.own) == set(LITERAL)


@pytest.mark.parametrize("distance", DISTANCES.own)
def test_symmetric_and_zero_on_itself_to_the_last_bit(distance: str) -> None:
    logs = log_signatures(some_values(40))
    between = pairwise(distance, logs, logs)
    assert (between == between.T).all()
    assert (np.diag(between) == 0).all()
    assert (between[~np.eye(40, dtype=bool)] > 0).all()


@pytest.mark.parametrize("distance", ["d1", "log"])
def test_triangle_inequality(distance: str) -> None:
    logs = log_signatures(some_values(30, spread=2.0))
    d = pairwise(distance, logs, logs)
    by_way_of = (d[:, :, np.newaxis] + d[np.newaxis, :, :]).min(axis=1)
    assert (d <= by_way_of + 1e-12).all()


def test_d2_is_no_metric() -> None:
    logs = log_signatures([[1.0], [10.0], [100.0]])
    d = pairwise("d2", logs, logs)
    assert d[0, 2] > d[0, 1] + d[1, 2]


def test_log_bounds_d2_from_below_and_meets_it_near_zero() -> None:
    logs = log_signatures(some_values(30, spread=2.0))
    assert (pairwise("log", logs, logs) <= pairwise("d2", logs, logs) * (1 + 1e-14)).all()
    near = logs + 1e-4 * np.random.default_rng(2).normal(size=logs.shape)
    ratio = np.diag(pairwise("d2", logs, near)) / np.diag(pairwise("log", logs, near))
    np.testing.assert_allclose(ratio, 1, atol=1e-8)


def test_d1_is_at_most_the_number_of_values() -> None:
    d = pairwise("d1", np.zeros((1, 7)), np.full((1, 7), 1000.0))
    assert d[0, 0] == 7


def test_d2_of_signatures_too_far_apart_is_infinite() -> None:
    assert pairwise("d2", np.array([[-720.0]]), np.array([[720.0]]))[0, 0] == np.inf


@pytest.mark.parametrize("distance", DISTANCES.own)
def test_a_common_factor_changes_nothing(distance: str) -> None:
    a, b, factor = some_values(4), some_values(6, seed=1), some_values(1, seed=2)
    np.testing.assert_allclose(
        pairwise(distance, log_signatures(a * factor), log_signatures(b * factor)),
        pairwise(distance, log_signatures(a), log_signatures(b)),
        rtol=1e-10,
    )


@pytest.mark.parametrize("distance", DISTANCES.own)
def test_a_pair_does_not_depend_on_its_company(distance: str) -> None:
    # 9000 × 31 values are more than one chunk.
    gallery = log_signatures(some_values(9000, n_values=31))
    queries = gallery[[0, 5000, 8999]]
    together = pairwise(distance, queries, gallery)
    assert (together[1] == pairwise(distance, queries[1:2], gallery)[0]).all()
    assert (together[:, 8999] == pairwise(distance, queries, gallery[8999:])[:, 0]).all()


@pytest.mark.parametrize("distance", DISTANCES.own)
def test_nothing_to_compare(distance: str) -> None:
    assert pairwise(distance, np.zeros((0, 3)), np.zeros((4, 3))).shape == (0, 4)
    assert pairwise(distance, np.zeros((4, 3)), np.zeros((0, 3))).shape == (4, 0)


def test_unknown_distance() -> None:
    with pytest.raises(OptionError, match=r"there is no distance 'D2'; there are log, d1, d2"):
        pairwise("D2", np.zeros((1, 3)), np.zeros((1, 3)))


@pytest.mark.parametrize(("queries", "gallery"), [((2, 3), (2, 4)), ((3,), (2, 3)), ((2, 3), (3,))])
def test_shapes_that_do_not_fit(queries: tuple[int, ...], gallery: tuple[int, ...]) -> None:
    message = re.escape(f"must have shapes (Q, L) and (N, L), got {queries} and {gallery}")
    with pytest.raises(InputError, match=message):
        pairwise("log", np.zeros(queries), np.zeros(gallery))


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf])
def test_values_without_a_logarithm(bad: float) -> None:
    with pytest.raises(InputError, match=rf"positive and finite, got {bad} \(1 such values of 3\)"):
        log_signatures([0.5, bad, 0.25])


def test_values_that_are_no_numbers() -> None:
    with pytest.raises(InputError, match="must be an array of numbers, got 'bunny'"):
        log_signatures("bunny")
