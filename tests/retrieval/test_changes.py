"""Indexes after shapes were added and removed, and the hard cases of the search, against brute force."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
import pytest

from pcretrieve.errors import InputError
from pcretrieve.options import RetrievalOptions
from pcretrieve.retrieval import (
    DISTANCES,
    SignatureIndex,
    blocks,
    compiled,
    filtering,
    interpreted,
    pairwise,
    with_shapes,
    without_shapes,
)
from pcretrieve.retrieval.blocks import BLOCK_SIZE
from pcretrieve.retrieval.filtering import Filter
from pcretrieve.retrieval.searches import SEARCHES
from pcretrieve.values import FloatArray, SignatureTable


def a_table(numbers: range, n_values: int = 9) -> SignatureTable:
    """Signatures that depend on their number alone, in a shuffled order of ids; nine of ten are equal."""
    logs = np.array(
        [np.random.default_rng(number // 10 * (number % 10 > 0)).normal(size=n_values) for number in numbers]
    )
    return SignatureTable(
        tuple(f"T{number * 7919 % 10007}" for number in numbers), np.exp(logs), "r-bihdm", "3f2a"
    )


def assert_same_answers(changed: SignatureIndex, built: SignatureIndex, queries: FloatArray) -> None:
    assert list(changed.ids) == list(built.ids)
    for values in queries:
        assert changed.query(values, 7) == built.query(values, 7)


@pytest.fixture
def few_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    """Small tables are searched by blocks too, in several turns, and few shapes get an exact distance."""
    monkeypatch.setattr(filtering, "N_ALL", 0)
    monkeypatch.setattr(filtering, "N_BLOCKS", 1)
    monkeypatch.setattr(filtering, "GROWTH", 2)
    monkeypatch.setattr(filtering, "N_LAST", 0)
    monkeypatch.setattr(blocks, "BLOCK_SIZE", 128)


@pytest.mark.parametrize("whitening", ["none", "pca"])
@pytest.mark.parametrize("distance", DISTANCES.own)
@pytest.mark.parametrize("n_new", [1, 40, BLOCK_SIZE + 60])
def test_an_index_with_further_shapes_is_one_of_all(n_new: int, distance: str, whitening: str) -> None:
    old, new, both = (a_table(range(*ends)) for ends in ((0, 1500), (1500, 1500 + n_new), (0, 1500 + n_new)))
    index = SignatureIndex(old, RetrievalOptions(distance=distance, whitening=whitening))
    changed = with_shapes(index, new)
    built = SignatureIndex(
        both, RetrievalOptions(distance=distance, whitening="none"), whitening=index.whitening
    )
    assert_same_answers(changed, built, both.values[:: len(both) // 30])
    assert len(index) == 1500
    assert sorted(changed.contents.filter.bounds.blocks.rows.ravel())[-len(both) :] == list(range(len(both)))  # type: ignore[union-attr]


@pytest.mark.parametrize("distance", DISTANCES.own)
def test_shapes_come_one_by_one_and_go_again(distance: str, few_compared: None) -> None:
    table = a_table(range(120))
    index = SignatureIndex(a_table(range(60)), RetrievalOptions(distance=distance, whitening="none"))
    for number in range(60, 120):
        index = with_shapes(index, a_table(range(number, number + 1)))
    assert_same_answers(
        index, SignatureIndex(table, RetrievalOptions(distance=distance, whitening="none")), table.values
    )
    gone = table.ids[::3]
    left = [row for row in range(120) if row % 3]
    rest = SignatureTable(tuple(table.ids[row] for row in left), table.values[left], "r-bihdm", "3f2a")
    index = without_shapes(index, gone)
    assert_same_answers(
        index, SignatureIndex(rest, RetrievalOptions(distance=distance, whitening="none")), table.values
    )
    index = SignatureIndex.from_arrays(without_shapes(index, rest.ids[:-1]).to_arrays())
    assert index.query(table.values[0], 5).ids == rest.ids[-1:]
    with pytest.raises(InputError, match="an index needs at least 1 shape"):
        without_shapes(index, rest.ids[-1:])


def test_what_cannot_be_added_or_removed() -> None:
    index = SignatureIndex(a_table(range(5)))
    assert with_shapes(index, SignatureTable((), np.zeros((0, 9)), "r-bihdm", "3f2a")) is index
    with pytest.raises(InputError, match="must be new to the index, got 'T7919', which it has"):
        with_shapes(index, a_table(range(1, 2)))
    with pytest.raises(InputError, match=r"signatures must have 9 values, .* got 8"):
        with_shapes(index, a_table(range(7, 8), n_values=8))
    other = SignatureTable(("x",), np.ones((1, 9)), "shape-dna", "3f2a")
    with pytest.raises(InputError, match="same method and options"):
        with_shapes(index, other)
    with pytest.raises(InputError, match="must be one of the 5 ranked shapes, got 'nobody'"):
        without_shapes(index, ["nobody"])


def test_how_neighbours_are_found_is_stated() -> None:
    few = SignatureIndex(a_table(range(20)), RetrievalOptions(whitening="none"))
    assert repr(few) == (
        "SignatureIndex(20 shapes of 9 values, distance log, whitening none: all shapes compared)"
    )
    many = repr(SignatureIndex(a_table(range(1500)), RetrievalOptions(distance="d1", whitening="none")))
    assert many.endswith("2 blocks of up to 768 shapes, bounds of 9 values)")


def hard_galleries(rng: np.random.Generator) -> dict[str, FloatArray]:
    """Galleries (N, L) that are hard for blocks, for cells, or for single precision."""
    plain = rng.normal(size=(2500, 9)) * np.geomspace(2, 0.01, 9)
    outlier = plain.copy()
    outlier[17] = 1e12
    return {
        "plain": plain,
        "all equal": np.repeat(plain[:1], 2500, axis=0),
        "clusters of duplicates": plain[rng.integers(20, size=2500)],
        "on a lattice": np.round(plain, 1),
        "one far outlier": outlier,
        "all but equal, far from zero": 600 + 1e-9 * plain,
        **{f"{n} shapes": plain[:n] for n in range(1, 6)},
        "one value": plain[:, :1],
        "many values": rng.normal(size=(1100, 150)),
    }


WAYS = [*((distance, "scan") for distance in DISTANCES.own), *product(("log", "d2"), SEARCHES)]


@pytest.mark.parametrize("name", hard_galleries(np.random.default_rng(0)))
@pytest.mark.parametrize(("distance", "nearest"), WAYS)
def test_hard_cases_keep_all_neighbours(distance: str, nearest: str, name: str, few_compared: None) -> None:
    rng = np.random.default_rng(1)
    points = hard_galleries(rng)[name]
    found = Filter.of(distance, points, nearest=nearest)
    near = points[rng.integers(len(points), size=4)]
    queries = [*near, *(near[:2] + 1e-7), rng.normal(size=points.shape[1]) * 100]
    for query in queries:
        exact = pairwise(distance, query[np.newaxis], points)[0]
        for k in {1, min(10, len(points)), len(points)}:
            wanted = set(np.flatnonzero(exact <= np.partition(exact, k - 1)[k - 1]))
            for scan in (interpreted.scan, compiled.scan):
                candidates = found.candidates(query[np.newaxis], k, scan)
                assert wanted <= set(candidates)
                assert (np.diff(candidates) > 0).all()


def drawn_points(rng: np.random.Generator) -> FloatArray:
    """Points (N, L) of a random number, with random scales, copies, grids, outliers and offsets."""
    n, n_values = int(rng.choice([1, 2, 5, 63, 64, 65, 300, 1100])), int(rng.choice([1, 2, 3, 9, 45, 70]))
    points = rng.normal(size=(n, n_values)) * 10 ** rng.uniform(-6, 2, size=n_values)
    if rng.random() < 0.4:
        points = points[rng.integers(max(1, n // 7), size=n)]
    if rng.random() < 0.3:
        points = np.round(points, 1)
    if rng.random() < 0.3:
        points[rng.integers(n)] *= 10 ** rng.uniform(0, 12)
    if rng.random() < 0.3:
        points += rng.normal() * 1000
    if rng.random() < 0.3:
        points[:, rng.integers(n_values)] = 1.5
    return points


SCANS = [(*way, interpreted.scan) for way in WAYS] + [(*way, compiled.scan) for way in WAYS[:3]]


@pytest.mark.parametrize(("distance", "nearest", "scan"), SCANS)
@pytest.mark.parametrize("seed", range(40))
def test_drawn_galleries_give_the_answers_of_all_distances(
    seed: int, distance: str, nearest: str, scan: Callable[..., int], few_compared: None
) -> None:
    """To the last bit, and equal distances in the order of the rows, before and after changes."""
    rng = np.random.default_rng(1000 + seed)
    points = drawn_points(rng)
    n, n_values = points.shape
    old = np.sort(rng.choice(n, size=max(1, n // 2), replace=False)).astype(np.int32)
    new = np.setdiff1d(np.arange(n, dtype=np.int32), old)
    keep = rng.random(size=(n,)) < 0.8
    keep[rng.integers(n)] = True
    whole = Filter.of(distance, points, int(rng.integers(1, n_values + 1)), nearest=nearest)
    half = Filter.of(distance, points[old], nearest=nearest)
    grown = half.extended(points, old, new) if len(new) else whole
    filters = (whole, grown, grown.kept(keep))
    stored = points[rng.integers(n, size=1)]
    far = 10 ** rng.uniform(-3, 3) * rng.normal(size=(1, n_values))
    queries: tuple[FloatArray, ...] = (stored, points[:1] + 1e-7, far)
    for found in filters:
        for query in queries:
            k = min(int(rng.choice([1, 5, 20, n])), len(found.points))
            every = pairwise(distance, query, found.points)[0]
            candidates = found.candidates(query, k, scan)
            exact = pairwise(distance, query, found.points[candidates])[0]
            first = candidates[np.argsort(exact, kind="stable")[:k]]
            np.testing.assert_array_equal(first, np.argsort(every, kind="stable")[:k])
            np.testing.assert_array_equal(exact, every[candidates])


def test_threads_change_no_answer() -> None:
    table = a_table(range(1500))
    index = SignatureIndex(table)
    assert index.query_many(table.values[:60], 5, n_threads=3) == index.query_many(table.values[:60], 5)
