"""Lower bounds in single precision never exceed the distances."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from pcretrieve.retrieval import DISTANCES, pairwise
from pcretrieve.retrieval.lower_bounds import BLOCK, LowerBounds
from pcretrieve.types import FloatArray

N_VALUES = 12


def galleries() -> dict[str, FloatArray]:
    rng = np.random.default_rng(5)
    spread = rng.normal(size=(400, N_VALUES)) * np.geomspace(2, 0.02, N_VALUES)
    return {
        "spread": spread,
        "far from zero": spread + 600,
        "all but equal": 1e-9 * spread + 3,
        "equal": np.full((40, N_VALUES), -0.7),
        "one far outlier": np.concatenate([spread, [np.full(N_VALUES, 1e6)]]),
        "one": spread[:1],
    }


@pytest.mark.parametrize("distance", DISTANCES.own)
@pytest.mark.parametrize("name", galleries())
def test_no_signature_lies_within_a_distance_and_beyond_its_limit(name: str, distance: str) -> None:
    gallery = galleries()[name]
    bounds = LowerBounds.of(distance, gallery)
    rng = np.random.default_rng(6)
    queries = (gallery[0], gallery[-1], gallery[0] + 1e-7, rng.normal(size=N_VALUES) * 300)
    for query in queries:
        exact = pairwise(distance, query[np.newaxis], gallery)[0]
        found = bounds.to(query)
        for radius in np.unique(exact):
            within = found <= bounds.limit(query, radius * (1 + 1e-12) + 1e-11)
            assert within[exact <= radius].all()


@pytest.mark.parametrize("distance", DISTANCES.own)
def test_bounds_tell_near_from_far(distance: str) -> None:
    gallery = galleries()["spread"]
    bounds = LowerBounds.of(distance, gallery)
    exact = pairwise(distance, gallery[:1], gallery)[0]
    radius = float(np.quantile(exact, 0.02))
    within = bounds.to(gallery[0]) <= bounds.limit(gallery[0], radius)
    assert within.sum() < 0.1 * len(gallery)


def test_tables_longer_than_a_block() -> None:
    rng = np.random.default_rng(7)
    gallery = rng.normal(size=(BLOCK + 3, 4))
    bounds = LowerBounds.of("d1", gallery)
    halves = [LowerBounds(False, bounds.mean, bounds.axes, bounds.coordinates[:, s]) for s in np.s_[:9, -9:]]
    whole = bounds.to(gallery[0])
    np.testing.assert_array_equal(whole[:9], halves[0].to(gallery[0]))
    np.testing.assert_array_equal(whole[-9:], halves[1].to(gallery[0]))


@pytest.mark.parametrize("distance", DISTANCES.own)
def test_queries_beyond_single_precision_leave_nothing_out(distance: str) -> None:
    gallery = galleries()["spread"]
    bounds = LowerBounds.of(distance, gallery)
    query = np.full(N_VALUES, 1e30)
    assert not (bounds.to(query) > bounds.limit(query, np.inf)).any()


def test_an_index_needs_no_scikit_learn() -> None:
    code = (
        "import sys, numpy; from pcretrieve.retrieval import SignatureIndex; "
        "from pcretrieve.types import SignatureTable; "
        "SignatureIndex(SignatureTable('ab', numpy.ones((2, 3)), 'k')).query(numpy.ones(3)); "
        "assert not {'sklearn', 'scipy', 'numba'} & set(sys.modules), sorted(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=100)
