"""Lower bounds in single precision never exceed the distances."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable

import numpy as np
import pytest

from pcretrieve.retrieval import DISTANCES, compiled, interpreted, pairwise
from pcretrieve.retrieval.blocks import BLOCK_SIZE
from pcretrieve.retrieval.filtering import ROUNDING
from pcretrieve.retrieval.lower_bounds import LowerBounds
from pcretrieve.values import FloatArray

N_VALUES = 12

Scan = Callable[..., int]

SCANS = (interpreted.scan, compiled.scan)


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
        "two blocks": np.concatenate([spread, spread + 1e-3, spread[:300] - 5]),
    }


def bounds_of_all(bounds: LowerBounds, point: FloatArray, scan: Scan) -> FloatArray:
    """(N,) lower bounds; infinite for rows that are in no block."""
    rows, found = bounds.to_rows(bounds.query(point), np.arange(len(bounds.blocks.rows)), np.inf, scan)
    every = np.full(bounds.blocks.n_rows, np.inf)
    every[rows] = found
    return every


@pytest.mark.parametrize("scan", SCANS)
@pytest.mark.parametrize("distance", DISTANCES.own)
@pytest.mark.parametrize("name", galleries())
def test_no_signature_lies_within_a_distance_and_beyond_its_limit(
    name: str, distance: str, scan: Scan
) -> None:
    gallery = galleries()[name]
    bounds = LowerBounds.of(distance, gallery)
    rng = np.random.default_rng(6)
    queries = (gallery[0], gallery[-1], gallery[0] + 1e-7, rng.normal(size=N_VALUES) * 300)
    for query in queries:
        exact = pairwise(distance, query[np.newaxis], gallery)[0]
        rounding = ROUNDING * N_VALUES**2 * max(np.abs(gallery).max(), np.abs(query).max())
        found = bounds_of_all(bounds, query, scan)
        blocks = bounds.to_blocks(bounds.query(query))
        for radius in np.unique(exact)[:: max(1, len(gallery) // 50)]:
            limit = bounds.limit(float(radius) * (1 + ROUNDING) + rounding)
            within = np.flatnonzero(exact <= radius)
            assert (found[within] <= limit).all()
            for block, rows in zip(blocks, bounds.blocks.rows, strict=True):
                assert block <= limit or not np.isin(within, rows).any()


@pytest.mark.parametrize("scan", SCANS)
@pytest.mark.parametrize("distance", DISTANCES.own)
def test_bounds_tell_near_from_far(distance: str, scan: Scan) -> None:
    gallery = galleries()["spread"]
    bounds = LowerBounds.of(distance, gallery)
    exact = pairwise(distance, gallery[:1], gallery)[0]
    radius = float(np.quantile(exact, 0.02))
    found, _ = bounds.to_rows(bounds.query(gallery[0]), np.array([0]), bounds.limit(radius), scan)
    assert set(np.flatnonzero(exact <= radius)) <= set(found.tolist())
    assert len(found) < 0.2 * len(gallery)


@pytest.mark.parametrize("distance", DISTANCES.own)
def test_compiled_bounds_are_those_of_numpy(distance: str) -> None:
    gallery = galleries()["two blocks"]
    bounds = LowerBounds.of(distance, gallery)
    assert len(bounds.blocks.rows) == 2
    for query in gallery[::100]:
        by_numpy, compiled_ones = (bounds_of_all(bounds, query, scan) for scan in SCANS)
        np.testing.assert_allclose(compiled_ones, by_numpy, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("scan", SCANS)
@pytest.mark.parametrize("distance", DISTANCES.own)
def test_queries_beyond_single_precision_leave_nothing_out(distance: str, scan: Scan) -> None:
    gallery = galleries()["spread"]
    bounds = LowerBounds.of(distance, gallery)
    query = np.full(N_VALUES, 1e30)
    assert bounds.limit(1e30) == (np.inf if bounds.euclidean else pytest.approx(1e30 * 2.164, rel=0.01))
    rows, _ = bounds.to_rows(bounds.query(query), np.array([0]), np.inf, scan)
    assert sorted(rows) == list(range(len(gallery)))


@pytest.mark.parametrize("n", [1, 2, BLOCK_SIZE, BLOCK_SIZE + 1, 5 * BLOCK_SIZE + 3])
def test_each_row_is_in_one_block(n: int) -> None:
    rng = np.random.default_rng(7)
    for gallery in (rng.normal(size=(n, 4)), np.ones((n, 4))):
        rows = LowerBounds.of("log", gallery).blocks.rows
        assert sorted(rows[rows >= 0]) == list(range(n))


def test_blocks_are_of_neighbours() -> None:
    """So that most blocks are farther from a query than its neighbours are."""
    gallery = np.random.default_rng(8).normal(size=(50 * BLOCK_SIZE, 3))
    bounds = LowerBounds.of("log", gallery)
    radius = float(np.sort(pairwise("log", gallery[:1], gallery)[0])[10])
    near = bounds.to_blocks(bounds.query(gallery[0])) <= bounds.limit(radius)
    assert 1 <= near.sum() < 0.2 * len(near)


def test_an_index_needs_no_scikit_learn() -> None:
    """Nor numba, which takes longer to load than a few queries."""
    code = (
        "import sys, numpy; from pcretrieve.retrieval import SignatureIndex; "
        "from pcretrieve.values import SignatureTable; "
        "index = SignatureIndex(SignatureTable('ab', numpy.ones((2, 3)), 'k')); "
        "index.query(numpy.ones(3)); "
        "assert not {'sklearn', 'scipy', 'numba'} & set(sys.modules), sorted(sys.modules); "
        "index.query_many(numpy.ones((20, 3))); "
        "assert 'numba' in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=100)
