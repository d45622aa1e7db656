"""Searches by other packages: what they find, what they cannot find, and that they change no answer."""

import pickle
import sys
from pathlib import Path

import numpy as np
import pytest

from pcretrieve.errors import InputError, OptionError
from pcretrieve.options import RetrievalOptions
from pcretrieve.retrieval import SignatureIndex, pairwise
from pcretrieve.retrieval.filtering import LARGEST, Filter
from pcretrieve.values import FloatArray, SignatureTable

STATED = {"tree": "ball tree of scikit-learn", "faiss": "flat scan of faiss"}
EUCLIDEAN = ("log", "d2")


def a_table(n: int = 300) -> SignatureTable:
    """Signatures of which the last third repeats the first."""
    logs = np.random.default_rng(0).normal(size=(n, 9)) * 0.3
    logs[-n // 3 :] = logs[: n // 3]
    return SignatureTable(tuple(f"T{number * 7919 % 10007}" for number in range(n)), np.exp(logs), "r-bihdm")


def clusters(n: int) -> FloatArray:
    rng = np.random.default_rng(0)
    return rng.normal(size=(n // 5, 20))[np.arange(n) // 5] + 0.1 * rng.normal(size=(n, 20))


@pytest.mark.parametrize("whitening", ["none", "pca"])
@pytest.mark.parametrize("distance", EUCLIDEAN)
@pytest.mark.parametrize("nearest", STATED)
def test_answers_are_those_of_the_scan(nearest: str, distance: str, whitening: str, tmp_path: Path) -> None:
    """Also of an index that was pickled, or mapped into memory."""
    table = a_table()
    options = RetrievalOptions(distance=distance, whitening=whitening)
    scanned = SignatureIndex(table, options.model_copy(update={"nearest": "scan"}))
    index = SignatureIndex(table, options.model_copy(update={"nearest": nearest}))
    for name, array in index.to_arrays().items():
        np.save(tmp_path / f"{name}.npy", array, allow_pickle=False)
    mapped = {path.stem: np.load(path, mmap_mode="r") for path in tmp_path.iterdir()}
    for found in (index, pickle.loads(pickle.dumps(index)), SignatureIndex.from_arrays(mapped)):
        assert STATED[nearest] in repr(found)
        for values in (*table.values[:10], *table.values[:10] * 1.1):
            for k in (1, 7, 299, 300, 1000):
                assert found.query(values, k) == scanned.query(values, k)


@pytest.mark.parametrize("distance", EUCLIDEAN)
@pytest.mark.parametrize("nearest", STATED)
def test_few_shapes_are_candidates(nearest: str, distance: str) -> None:
    points = clusters(5000)
    found = Filter.of(distance, points, nearest=nearest)
    numbers = [len(found.candidates(point[np.newaxis], 5)) for point in points[:50]]
    assert np.median(numbers) <= 20


@pytest.mark.parametrize("nearest", STATED)
def test_as_many_equal_distances_as_there_are(nearest: str) -> None:
    """More than the search is asked for at first."""
    points = np.repeat(clusters(50), 40, axis=0)
    found = Filter.of("log", points, nearest=nearest)
    assert set(range(40)) <= set(found.candidates(points[:1], 3))


@pytest.mark.parametrize("nearest", STATED)
def test_numbers_whose_squares_overflow_are_all_compared(nearest: str) -> None:
    rng = np.random.default_rng(0)
    for points, point in (
        (rng.normal(size=(200, 3)) * 1e30, np.zeros((1, 3))),
        (rng.normal(size=(200, 3)), np.full((1, 3), LARGEST)),
    ):
        found = Filter.of("log", points, nearest=nearest)
        exact = pairwise("log", point, points)[0]
        assert np.argsort(exact)[0] in found.candidates(point, 1)
    huge = np.array([[700.0], [-700.0], [699.0]])
    assert len(Filter.of("d2", huge, nearest=nearest).candidates(np.full((1, 1), -705.0), 2)) == 3


@pytest.mark.parametrize("nearest", STATED)
def test_distances_that_are_not_bounded_by_the_euclidean_one_are_refused(nearest: str) -> None:
    message = f"distance must be log or d2 for nearest = '{nearest}', .* got 'd1'; use nearest = 'scan'"
    with pytest.raises(OptionError, match=message):
        SignatureIndex(a_table(), RetrievalOptions.model_validate({"distance": "d1", "nearest": nearest}))


def test_without_faiss_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "faiss", None)
    with pytest.raises(InputError, match=r"not installed: pip install 'pcretrieve\[faiss\]'"):
        SignatureIndex(a_table(), RetrievalOptions(nearest="faiss"))
