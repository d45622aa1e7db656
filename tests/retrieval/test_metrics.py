"""Signatures that are not compared by their logarithms, and distances of other packages."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from packages import install

from pcretrieve.errors import InputError, OptionError
from pcretrieve.evaluation import evaluate_table
from pcretrieve.options import RetrievalOptions
from pcretrieve.retrieval import Distance, SignatureIndex, coordinates, pairwise, table_coordinates
from pcretrieve.values import FloatArray, Metric, Signature, SignatureTable

N, L = 200, 6


def a_table(metric: Metric) -> SignatureTable:
    """Classes of five shapes that are near to each other."""
    rng = np.random.default_rng(3)
    values = np.repeat(rng.normal(size=(N // 5, L)), 5, axis=0) + 0.01 * rng.normal(size=(N, L))
    if metric == "histograms":
        values = values**2
        values /= values.sum(axis=1, keepdims=True)
    labels = tuple(f"class{number // 5}" for number in range(N))
    return SignatureTable(tuple(f"s{number:03}" for number in range(N)), values, "x", "3f", labels, metric)


def hellinger(values: FloatArray, query: FloatArray) -> FloatArray:
    """By the Bhattacharyya coefficient."""
    return np.asarray(np.sqrt(np.maximum(1 - np.sqrt(values * query).sum(axis=1), 0)))


@pytest.mark.parametrize("whitening", ["none", "pca"])
def test_values_are_compared_as_they_are(whitening: str) -> None:
    table = a_table("values")
    index = SignatureIndex(table, RetrievalOptions(whitening=whitening))
    found = index.query(Signature(table.values[3], "x", "3f", metric="values"), 9)
    assert found.ids[0] == "s003"
    if whitening == "none":
        gaps = np.linalg.norm(table.values - table.values[3], axis=1)
        assert found.ids == tuple(table.ids[row] for row in np.argsort(gaps)[:9])
        np.testing.assert_allclose(found.distances, np.sort(gaps)[:9], atol=1e-12)


def test_histograms_are_compared_by_the_hellinger_distance() -> None:
    table = a_table("histograms")
    found = SignatureIndex(table, RetrievalOptions(whitening="none")).query(table.values[3], 9)
    gaps = hellinger(table.values, table.values[3])
    assert found.ids == tuple(table.ids[row] for row in np.argsort(gaps, kind="stable")[:9])
    np.testing.assert_allclose(found.distances / np.sqrt(2), np.sort(gaps)[:9], atol=1e-7)


@pytest.mark.parametrize("whitening", ["none", "pca", "within-class"])
@pytest.mark.parametrize("metric", ["values", "histograms"])
def test_they_are_evaluated_like_any_other(metric: Metric, whitening: str) -> None:
    measures = evaluate_table(a_table(metric), RetrievalOptions(whitening=whitening))
    assert measures.map > 0.95


@pytest.mark.parametrize(
    ("values", "metric", "message"),
    [
        ([1.0, -1.0], "histograms", r"must be bins of a histogram, not negative, got -1.0 \(1 such"),
        ([1.0, np.inf], "values", "signature values must be finite, got inf"),
        ([0.0], "logarithms", "signature values must be positive and finite, got 0.0"),
    ],
)
def test_values_that_a_metric_does_not_allow(values: list[float], metric: Metric, message: str) -> None:
    with pytest.raises(InputError, match=message):
        coordinates(values, metric)


@pytest.mark.parametrize("distance", ["d1", "d2"])
def test_ratios_mean_nothing_for_values_that_may_be_negative(distance: str) -> None:
    with pytest.raises(OptionError, match="distance must be log for x, which is compared as values"):
        SignatureIndex(a_table("values"), RetrievalOptions(distance=distance))
    with pytest.raises(OptionError, match="distance must be log for x, which is compared as histograms"):
        evaluate_table(a_table("histograms"), RetrievalOptions(distance=distance, whitening="within-class"))


# --- distances of other packages ------------------------------------------------------------------------

MODULE = """
import numpy as np

from pcretrieve.retrieval import Distance

HALF = Distance("half", lambda x: np.linalg.norm(x, axis=-1) / 2)
TWICE = Distance("twice", lambda x: 2 * np.linalg.norm(x, axis=-1), at_least="log")
FLAT = Distance("flat", lambda x: x)
"""
ENTRY_POINTS = "[pcretrieve.distances]\nhalf = theirs:HALF\ntwice = theirs:TWICE\nflat = theirs:FLAT\n"


@pytest.mark.parametrize("distance", ["half", "twice"])
def test_the_index_finds_the_nearest_by_any_distance(
    distance: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path / "site", "theirs", {"theirs": MODULE}, ENTRY_POINTS, monkeypatch)
    values = np.exp(np.random.default_rng(5).normal(size=(2000, L)))
    table = SignatureTable(tuple(f"s{number:04}" for number in range(2000)), values, "x")
    index = SignatureIndex(table, RetrievalOptions(distance=distance, whitening="none"))
    exact = pairwise(distance, table_coordinates(table, distance)[:20], table_coordinates(table, distance))
    for row in range(20):
        nearest = index.query(values[row], 7)
        order = np.argsort(exact[row], kind="stable")[:7]
        assert nearest.ids == tuple(table.ids[number] for number in order)
        np.testing.assert_array_equal(nearest.distances, exact[row, order])


def test_a_distance_that_fails_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path / "site", "theirs", {"theirs": MODULE}, ENTRY_POINTS, monkeypatch)
    with pytest.raises(OptionError, match="the distance 'flat' of the package theirs failed, ValueError"):
        pairwise("flat", np.zeros((2, 3)), np.zeros((2, 3)))


def test_records_that_declare_what_does_not_exist() -> None:
    with pytest.raises(OptionError, match=r"metrics of a distance must be of logarithms, .* got 'angles'"):
        Distance("x", np.sum, metrics=("angles",))  # type: ignore[arg-type]
    with pytest.raises(OptionError, match="at_least must be 'log' or 'd1', got 'd2'"):
        Distance("x", np.sum, at_least="d2")  # type: ignore[arg-type]
