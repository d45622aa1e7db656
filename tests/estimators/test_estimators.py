"""Estimators for scikit-learn: its own checks, its tools, and the numbers of the functions behind them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import shapes
from sklearn.base import BaseEstimator
from sklearn.exceptions import NotFittedError
from sklearn.pipeline import make_pipeline
from sklearn.utils.estimator_checks import check_estimator

import pcretrieve as pr
from pcretrieve.errors import InputError, OptionError, ShapeError
from pcretrieve.estimators import (
    NeighbourWhitening,
    PCAWhitening,
    ResolutionWhitening,
    SignatureNeighbors,
    SignatureTransformer,
    WithinClassWhitening,
)
from pcretrieve.options import PipelineOptions, RetrievalOptions, SignatureOptions
from pcretrieve.retrieval import (
    DISTANCES,
    SignatureIndex,
    coordinates,
    fit_whitening,
    pairwise,
    resolution_whitening,
)
from pcretrieve.values import FloatArray, SignatureTable, TriangleMesh

ESTIMATORS = [
    NeighbourWhitening(),
    PCAWhitening(),
    WithinClassWhitening(),
    ResolutionWhitening(),
    SignatureNeighbors(n_neighbors=1),
]


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=str)
def test_checks_of_scikit_learn(estimator: BaseEstimator) -> None:
    check_estimator(estimator, on_skip=None)


def some_logs(n: int = 60, n_values: int = 8, *, seed: int = 0) -> tuple[FloatArray, list[str]]:
    """Log-signatures of classes of six, which differ where poses do not."""
    rng = np.random.default_rng(seed)
    centres = rng.normal(size=(n // 6, n_values)) * np.geomspace(0.3, 0.02, n_values)
    poses = rng.normal(size=(n, n_values)) * np.geomspace(0.02, 1.0, n_values)
    labels = [f"class {row // 6:02}" for row in range(n)]
    return np.repeat(centres, 6, axis=0) + poses - 3, labels


# --- whitenings -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("shrinkage", ["auto"])
def test_whitenings_are_those_of_the_functions(shrinkage: Any) -> None:
    logs, labels = some_logs()
    expected = {
        NeighbourWhitening(3, shrinkage): fit_whitening(
            "neighbours", logs, n_neighbors=3, shrinkage=shrinkage
        ),
        PCAWhitening(shrinkage): fit_whitening("pca", logs, shrinkage=shrinkage),
        WithinClassWhitening(shrinkage): fit_whitening("within-class", logs, labels, shrinkage=shrinkage),
        ResolutionWhitening("relative", shrinkage): resolution_whitening(
            SignatureOptions(method="r-bihdm", n_values=8, scale="relative"), shrinkage=shrinkage
        ),
    }
    for estimator, whitening in expected.items():
        assert estimator.fit(logs, labels).whitening_ == whitening
        np.testing.assert_array_equal(estimator.transform(logs[:5]), whitening.apply(logs[:5]))


def test_parameters_out_of_range() -> None:
    logs, labels = some_logs()
    for estimator in (
        NeighbourWhitening(shrinkage=2),
        PCAWhitening(2),
        WithinClassWhitening(2),
        ResolutionWhitening(shrinkage=2),
    ):
        with pytest.raises(OptionError, match=r"shrinkage must lie in \(0, 1\], got 2"):
            estimator.fit(logs, labels)
    with pytest.raises(OptionError, match="has been measured for r-bihdm with n_modes = 60, by area or"):
        ResolutionWhitening("absolute").fit(logs)


# --- neighbours -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("distance", DISTANCES)
def test_neighbours_are_those_of_the_index(distance: str) -> None:
    logs, _ = some_logs()
    logs[-6:] = logs[:6]  # equally far
    ids = tuple(f"{row:02}" for row in range(60))
    plain = RetrievalOptions(distance=distance, whitening="none")
    index = SignatureIndex(SignatureTable(ids, np.exp(logs), "x"), plain)
    logs = coordinates(np.exp(logs))
    estimator = SignatureNeighbors(distance=distance).fit(logs)
    distances, rows = estimator.kneighbors(logs[:9] + 0.01, 7)
    for point, own, nearest in zip(logs[:9] + 0.01, distances, rows, strict=True):
        found = index.query(np.exp(point), 7)
        assert found.ids == tuple(ids[row] for row in nearest)
        np.testing.assert_allclose(found.distances, own, rtol=1e-9)
    np.testing.assert_array_equal(estimator.kneighbors(logs[:9] + 0.01, 7, return_distance=False), rows)


@pytest.mark.parametrize("distance", DISTANCES)
def test_all_within_a_radius_are_found(distance: str) -> None:
    logs, _ = some_logs()
    estimator = SignatureNeighbors(distance=distance).fit(logs)
    apart = pairwise(distance, logs, logs)
    limit = float(np.sort(apart, axis=1)[:, 5].max())
    for queries, expected in ((logs, apart), (None, np.where(np.eye(60, dtype=bool), np.inf, apart))):
        distances, rows = estimator.radius_neighbors(queries, limit)
        for own, near, all_of in zip(distances, rows, expected, strict=True):
            assert sorted(near) == np.flatnonzero(all_of <= limit).tolist()
            np.testing.assert_array_equal(own, np.sort(all_of[near]))
    assert [len(near) for near in estimator.radius_neighbors(radius=0.0, return_distance=False)] == [0] * 60


def test_the_score_is_the_mean_average_precision_of_new_queries() -> None:
    gallery = np.array([[0.0], [1.0], [2.0], [3.0]])
    estimator = SignatureNeighbors().fit(gallery, ["a", "b", "a", "b"])
    # From .4 the order is a b a b, and from 2.9 it is b a b a; no shape of the class c was fitted.
    assert estimator.score([[0.4]], ["a"]) == pytest.approx((1 + 2 / 3) / 2)
    assert estimator.score([[0.4], [2.9], [0.0]], ["b", "a", "c"]) == pytest.approx((1 / 2 + 2 / 4) / 2)
    with pytest.raises(InputError, match="a score needs queries of fitted classes, got none"):
        estimator.score([[0.4]], ["c"])
    with pytest.raises(InputError, match="give y to fit"):
        SignatureNeighbors().fit(gallery).score([[0.4]], ["a"])


def test_what_neighbours_cannot_be_asked() -> None:
    logs, labels = some_logs()
    estimator = SignatureNeighbors().fit(logs)
    number: Any
    for number in (0, 61, 2.5, True):
        with pytest.raises(OptionError, match=f"n_neighbors to be a whole number from 1 to 60, got {number}"):
            estimator.kneighbors(logs, number)
    with pytest.raises(OptionError, match="from 1 to 59, got 60"):
        estimator.kneighbors(n_neighbors=60)
    with pytest.raises(OptionError, match="there is no distance 'l2'"):
        SignatureNeighbors(distance="l2").fit(logs)
    with pytest.raises(InputError, match="y must have 60 classes, one a row, got 59"):
        SignatureNeighbors().fit(logs, labels[1:])
    with pytest.raises(NotFittedError):
        SignatureNeighbors().kneighbors(logs)


# --- scans ----------------------------------------------------------------------------------------------

KEEP = {"surface": {"mode": "keep"}}


def eggs() -> tuple[list[TriangleMesh], list[str]]:
    """Four kinds of eggs, three of each."""
    made = [
        shapes.ellipsoid((1 + 0.1 * number, 1, 1.2 + 0.2 * kind), subdivisions=2)
        for kind in range(4)
        for number in range(3)
    ]
    return made, [f"kind {kind}" for kind in range(4) for _ in range(3)]


def test_what_is_no_sequence_of_scans() -> None:
    with pytest.raises(InputError, match=r"X must be a sequence of scans, got the path egg\.off: put"):
        SignatureTransformer().transform("egg.off")
    with pytest.raises(InputError, match="points must have shape"):
        SignatureTransformer().transform(np.zeros((5, 3)))
    with pytest.raises(ShapeError, match=r"\[absent.off / read\]"):
        SignatureTransformer().transform(["absent.off"])
    with pytest.raises(OptionError, match="method: input should be one of"):
        SignatureTransformer(method="sift").fit([])


# --- tools of scikit-learn ------------------------------------------------------------------------------


def test_from_scans_to_neighbours_in_one_pipeline() -> None:
    meshes, kinds = eggs()
    search = make_pipeline(
        SignatureTransformer(KEEP, n_values=9), WithinClassWhitening(), SignatureNeighbors(n_neighbors=2)
    )
    search.fit(meshes, kinds)
    new = shapes.ellipsoid((1.05, 1, 1.6), subdivisions=2)
    distances, rows = search[-1].kneighbors(search[:-1].transform([new]))
    assert {kinds[row] for row in rows[0]} == {"kind 2"}
    table = SignatureTable(
        tuple(f"{row:02}" for row in range(12)),
        np.exp(SignatureTransformer(KEEP, n_values=9).transform(meshes)),
        "r-bihdm",
        labels=tuple(kinds),
    )
    index = SignatureIndex(table, RetrievalOptions(whitening="within-class"))
    options = PipelineOptions().changed(**KEEP, signature={"n_values": 9})
    found = index.query(pr.signature(new, options).values, 2)
    assert found.ids == tuple(f"{row:02}" for row in rows[0])
    np.testing.assert_allclose(found.distances, distances[0], rtol=1e-9)
