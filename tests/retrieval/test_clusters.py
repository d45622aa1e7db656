"""Near pairs, clusters and maps of the shapes of an index."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from pcretrieve.options import RetrievalOptions
from pcretrieve.retrieval import SignatureIndex, near_pairs, pairwise, plane_map
from pcretrieve.retrieval.clusters import GAP
from pcretrieve.values import FloatArray, SignatureTable


def index_of(logs: FloatArray) -> SignatureIndex:
    ids = tuple(f"{row:04}" for row in range(len(logs)))
    return SignatureIndex(SignatureTable(ids, np.exp(logs), "any"), RetrievalOptions(whitening="none"))


def groups(sizes: list[int], spread: float, seed: int = 0) -> FloatArray:
    rng = np.random.default_rng(seed)
    centres = np.repeat(rng.normal(size=(len(sizes), 5)), sizes, axis=0)
    return centres + spread * rng.normal(size=centres.shape)


@pytest.mark.parametrize("n", [1, 2, 50, 1500])
def test_near_pairs_are_those_of_all_pairs(n: int) -> None:
    rng = np.random.default_rng(n)
    logs, errors = rng.normal(size=(n, 3)), rng.exponential(0.05, size=n)
    logs[: n // 10] = logs[0]  # equal ones
    index = index_of(logs)
    found = near_pairs(index, errors)
    distances, limits = pairwise("log", logs, logs), np.hypot(errors[:, None], errors)
    first, second = np.nonzero(np.triu(distances <= limits, k=1))
    assert {(int(pair.first), int(pair.second)) for pair in found} == set(
        zip(first.tolist(), second.tolist(), strict=True)
    )
    assert len(found) == len(first)
    expected = np.sort(distances[first, second])
    np.testing.assert_allclose([pair.distance for pair in found], expected, rtol=1e-12)
    assert all(pair.distance <= pair.limit for pair in found)


def test_a_map_keeps_neighbours_and_hides_none() -> None:
    labels = np.repeat(np.arange(8), 10)
    index = index_of(groups([10] * 8, 0.05))
    places = plane_map(index)
    assert places.min() >= 0 and places.max() <= 1
    np.testing.assert_allclose(np.ptp(places, axis=0).max(), 1)
    apart = cdist(places, places) + 9 * np.eye(80)
    assert (labels[apart.argmin(axis=1)] == labels).all()
    assert apart.min() > 0.5 * GAP
    np.testing.assert_array_equal(plane_map(index), places)
