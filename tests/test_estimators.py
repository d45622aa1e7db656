"""Estimators for scikit-learn: its own checks, its tools, and the numbers of the functions behind them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import shapes
from sklearn.base import BaseEstimator, clone
from sklearn.exceptions import NotFittedError
from sklearn.pipeline import make_pipeline
from sklearn.utils.estimator_checks import check_estimator
from tables import classes_of, posed_logs, table_of

import pcretrieve as pr
from pcretrieve.errors import InputError, OptionError, ShapeError
from pcretrieve.estimators import (
    NeighbourWhitening,
    PCAWhitening,
    PeopleWhitening,
    SignatureNeighbors,
    SignatureTransformer,
    WithinClassWhitening,
)
from pcretrieve.options import RetrievalOptions, SignatureOptions
from pcretrieve.pipeline.process import remembered
from pcretrieve.retrieval import (
    DISTANCES,
    SignatureIndex,
    coordinates,
    fit_whitening,
    pairwise,
    people,
)

WHITENINGS = (
    NeighbourWhitening(),
    PCAWhitening(),
    WithinClassWhitening(),
    PeopleWhitening("r-bihdm"),
)


@pytest.mark.parametrize(
    "estimator", [*WHITENINGS, SignatureNeighbors(n_neighbors=1)], ids=str
)
def test_checks_of_scikit_learn(estimator: BaseEstimator) -> None:
    check_estimator(estimator, on_skip=None)


def test_whitenings_are_those_of_the_functions() -> None:
    logs, labels = posed_logs(), classes_of(60, 6)
    known = people(SignatureOptions(method="r-bihdm", n_values=8))
    for estimator, whitening in (
        (NeighbourWhitening(0.2), fit_whitening("neighbours", logs, shrinkage=0.2)),
        (PCAWhitening(0.2), fit_whitening("pca", logs, shrinkage=0.2)),
        (WithinClassWhitening(), fit_whitening("within-class", logs, labels)),
        (PeopleWhitening("r-bihdm"), fit_whitening("people", logs, people=known)),
    ):
        assert estimator.fit(logs, labels).whitening_ == whitening
        np.testing.assert_array_equal(
            estimator.transform(logs[:5]), whitening.apply(logs[:5])
        )
    for estimator in WHITENINGS:
        with pytest.raises(OptionError, match=r"shrinkage must lie in \(0, 1\], got 2"):
            clone(estimator).set_params(shrinkage=2).fit(logs, labels)
    with pytest.raises(InputError, match="X must be signatures by area of hapt"):
        PeopleWhitening().fit(logs)


@pytest.mark.parametrize("distance", DISTANCES)
def test_neighbours_are_those_of_the_index_without_themselves(distance: str) -> None:
    logs = posed_logs()
    logs[-6:] = logs[:6]  # equally far
    table = table_of(logs)
    index = SignatureIndex(table, RetrievalOptions(distance=distance, whitening="none"))
    logs = coordinates(np.exp(logs))
    estimator = SignatureNeighbors(distance=distance).fit(logs)
    distances, rows = estimator.kneighbors(logs[:9] + 0.01, 7)
    for point, own, nearest in zip(logs[:9] + 0.01, distances, rows, strict=True):
        found = index.query(np.exp(point), 7)
        assert found.ids == tuple(table.ids[row] for row in nearest)
        np.testing.assert_allclose(found.distances, own, rtol=1e-9)
    np.testing.assert_array_equal(
        estimator.kneighbors(logs[:9] + 0.01, 7, return_distance=False), rows
    )
    own, rows = estimator.kneighbors(n_neighbors=59)
    apart = pairwise(distance, logs, logs)
    for number, (distances, nearest) in enumerate(zip(own, rows, strict=True)):
        assert sorted(nearest) == [row for row in range(60) if row != number]
        np.testing.assert_array_equal(distances, np.sort(apart[number][nearest]))


def test_no_signature_is_its_own_neighbour_whatever_is_compared_at_a_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    estimator = SignatureNeighbors().fit(posed_logs())
    whole = estimator.kneighbors(n_neighbors=59)
    monkeypatch.setattr("pcretrieve.estimators.BLOCK_DISTANCES", 7 * 60)
    for found, expected in zip(estimator.kneighbors(n_neighbors=59), whole, strict=True):
        np.testing.assert_array_equal(found, expected)


def test_surfaces_are_remembered_by_their_options() -> None:
    egg = shapes.ellipsoid((1, 1, 1.5), subdivisions=2)
    for n_pairs in (20, 30, 20):
        options = pr.PipelineOptions().changed(
            surface={"mode": "keep"},
            spectral={"n_pairs": n_pairs},
            signature={"n_modes": 10, "n_values": 5},
        )
        spectrum = remembered(egg, options).spectrum
        assert spectrum is not None and len(spectrum.eigenvalues) == n_pairs


def test_the_score_is_the_mean_average_precision_of_new_queries() -> None:
    gallery = np.array([[0.0], [1.0], [2.0], [3.0]])
    estimator = SignatureNeighbors().fit(gallery, ["a", "b", "a", "b"])
    # From .4 the order is a b a b, and from 2.9 it is b a b a; no shape of the class c was fitted.
    assert estimator.score([[0.4]], ["a"]) == pytest.approx((1 + 2 / 3) / 2)
    assert estimator.score([[0.4], [2.9], [0.0]], ["b", "a", "c"]) == pytest.approx(
        (1 / 2 + 2 / 4) / 2
    )
    with pytest.raises(
        InputError, match="a score needs queries of fitted classes, got none"
    ):
        estimator.score([[0.4]], ["c"])
    with pytest.raises(InputError, match="give y to fit"):
        SignatureNeighbors().fit(gallery).score([[0.4]], ["a"])


def test_what_neighbours_cannot_be_asked() -> None:
    logs, labels = posed_logs(), classes_of(60, 6)
    estimator = SignatureNeighbors().fit(logs)
    number: Any
    for number in (0, 61, 2.5, True):
        with pytest.raises(
            OptionError,
            match=f"n_neighbors to be a whole number from 1 to 60, got {number}",
        ):
            estimator.kneighbors(logs, number)
    with pytest.raises(OptionError, match="from 1 to 59, got 60"):
        estimator.kneighbors(n_neighbors=60)
    with pytest.raises(OptionError, match="there is no distance 'l2'"):
        SignatureNeighbors(distance="l2").fit(logs)
    with pytest.raises(InputError, match="y must have 60 classes, one a row, got 59"):
        SignatureNeighbors().fit(logs, labels[1:])
    with pytest.raises(NotFittedError):
        SignatureNeighbors().kneighbors(logs)


def test_what_is_no_sequence_of_scans() -> None:
    with pytest.raises(
        InputError, match=r"X must be a sequence of scans, got the path egg\.off: put"
    ):
        SignatureTransformer().transform("egg.off")
    with pytest.raises(InputError, match="points must have shape"):
        SignatureTransformer().transform(np.zeros((5, 3)))
    with pytest.raises(ShapeError, match=r"\[absent.off / read\]"):
        SignatureTransformer().transform(["absent.off"])
    with pytest.raises(OptionError, match="method: input should be one of"):
        SignatureTransformer(method="sift").fit([])


def test_from_scans_to_neighbours_in_one_pipeline(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Four kinds of eggs, three of each."""
    sizes = [
        (1 + 0.1 * number, 1, 1.2 + 0.2 * kind)
        for kind in range(4)
        for number in range(3)
    ]
    meshes = [shapes.ellipsoid(size, subdivisions=2) for size in sizes]
    kinds = classes_of(12, 3)
    keep = {"surface": {"mode": "keep"}}
    scans = SignatureTransformer(keep, method="r-bihdm", n_values=9)
    search = make_pipeline(
        scans, WithinClassWhitening(), SignatureNeighbors(n_neighbors=2)
    )
    search.fit(meshes, kinds)
    new = shapes.ellipsoid((1.05, 1, 1.6), subdivisions=2)
    rows = search[-1].kneighbors(search[:-1].transform([new]), return_distance=False)
    assert {kinds[row] for row in rows[0]} == {"class 002"}
    values = pr.signature(
        new, {**keep, "signature": {"n_values": 9}}, method="r-bihdm"
    ).values
    # Surfaces are remembered.
    monkeypatch.setattr("pcretrieve.pipeline.process.process", None)
    np.testing.assert_allclose(scans.transform([new]), [np.log(values)], rtol=1e-9)
