"""Distances by the formulas of the paper; the index against brute force, its lower bounds and its arrays."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from tables import table_of

from pcretrieve.errors import InputError, OptionError
from pcretrieve.options import RetrievalOptions
from pcretrieve.retrieval import (
    DISTANCES,
    DistanceMatrix,
    SignatureIndex,
    bounds,
    coordinates,
    fit_whitening,
    index,
    pairwise,
)
from pcretrieve.retrieval.bounds import LowerBounds, Rows, Singles
from pcretrieve.retrieval.distances import Distance, Positions
from pcretrieve.values import FloatArray, Metric, Neighbors, Signature, SignatureTable


def some_values(
    n: int, *, seed: int = 0, n_values: int = 23, spread: float = 1.0
) -> FloatArray:
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
    np.testing.assert_allclose(
        found, [[LITERAL[distance](p, q) for q in b] for p in a], rtol=1e-12
    )
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


def test_metric_laws() -> None:
    logs = coordinates(some_values(30, spread=2.0))
    for distance in ("d1", "log"):
        d = pairwise(distance, logs, logs)
        assert (
            d <= (d[:, :, np.newaxis] + d[np.newaxis, :, :]).min(axis=1) + 1e-12
        ).all()
    line = coordinates([[1.0], [10.0], [100.0]])
    d = pairwise("d2", line, line)
    assert d[0, 2] > d[0, 1] + d[1, 2], "d2 is no metric"
    assert (pairwise("log", logs, logs) <= pairwise("d2", logs, logs) * (1 + 1e-14)).all()
    assert pairwise("d1", np.zeros((1, 7)), np.full((1, 7), 1000.0))[0, 0] == 7


def test_what_has_no_distance_or_no_coordinates() -> None:
    with pytest.raises(
        OptionError, match="there is no distance 'D2'; there are log, d1, d2"
    ):
        pairwise("D2", np.zeros((1, 3)), np.zeros((1, 3)))
    metric: Metric
    for values, metric, message in (
        (
            [0.5, 0.0, 0.25],
            "logarithms",
            r"must be positive and finite, got 0.0 \(1 such values of 3\)",
        ),
        ([-1.0], "logarithms", "must be positive and finite, got -1.0"),
        ([np.nan], "logarithms", "must be positive and finite, got nan"),
        ([1.0, np.inf], "values", "signature values must be finite, got inf"),
        (
            [1.0, -1.0],
            "histograms",
            r"must be bins of a histogram, not negative, got -1.0 \(1 such",
        ),
        ("bunny", "logarithms", "must be an array of numbers, got 'bunny'"),
    ):
        with pytest.raises(InputError, match=message):
            coordinates(values, metric)


# --- the index ------------------------------------------------------------------------------------------


def a_table(
    n: int, *, seed: int = 0, n_values: int = 15, copies: int = 0
) -> SignatureTable:
    """Classes of five, in a shuffled order of ids; the last `copies` rows repeat the first ones."""
    rng = np.random.default_rng(seed)
    scale = np.geomspace(1, 0.05, n_values)
    centres = rng.normal(size=(n // 5 + 1, n_values)) * scale
    logs = centres[np.arange(n) // 5] + 0.3 * scale * rng.normal(size=(n, n_values)) - 3
    if copies:
        logs[-copies:] = logs[:copies]
    return replace(
        table_of(logs), ids=tuple(f"T{number}" for number in rng.permutation(n))
    )


def an_index(
    table: SignatureTable, distance: Distance = DISTANCES["log"], whitening: str = "none"
) -> SignatureIndex:
    return SignatureIndex(table, RetrievalOptions(whitening=whitening), distance=distance)


def assert_exact(
    found: Neighbors,
    made: SignatureIndex,
    table: SignatureTable,
    values: FloatArray,
    k: int,
) -> None:
    """Results are the first k of all shapes, sorted by (distance, id)."""
    query, gallery = (
        made.whitening.apply(coordinates(v)) for v in (values[np.newaxis], table.values)
    )
    distances = pairwise(made._distance, query, gallery)[0]
    ranked = sorted(zip(distances.tolist(), table.ids, strict=True))[:k]
    assert [*zip(found.distances.tolist(), found.ids, strict=True)] == ranked


OWN = (
    Distance("half", lambda x: np.linalg.norm(x, axis=-1) / 2),
    Distance("twice", lambda x: 2 * np.linalg.norm(x, axis=-1), exceeds_log=True),
)


@pytest.mark.parametrize("whitening", ("none", "pca"))
@pytest.mark.parametrize(
    "distance", (*DISTANCES.values(), *OWN), ids=lambda distance: distance.name
)
def test_agrees_with_brute_force(
    distance: Distance, whitening: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before and after compiled code is loaded; as arrays that are mapped, as a pickle, and as a matrix."""
    monkeypatch.setattr(index, "N_ALL", 0)
    table = a_table(300, copies=60)
    made = an_index(table, distance, whitening)
    copies = [made] * 3
    if distance.name in DISTANCES:
        copies[1:] = (
            pickle.loads(pickle.dumps(made)),
            SignatureIndex.from_arrays(made.to_arrays()),
        )
    rng = np.random.default_rng(100)
    near = table.values[:15] * np.exp(0.1 * rng.normal(size=(15, 15)))
    outside = np.exp(rng.normal(size=(15, 15)) * 8)
    far_outside = np.exp(rng.uniform(-300, 300, size=(5, 15)))
    for number, values in enumerate((*table.values[:15], *near, *outside, *far_outside)):
        for k in (1, 10, 299):
            assert_exact(copies[number % 3].query(values, k), made, table, values, k)
    matrix = DistanceMatrix(tuple(made.ids), made.between(made.ids))
    for shape_id in table.ids[::40]:
        assert matrix.nearest(shape_id, 7) == made.nearest(shape_id, 7)


@pytest.mark.parametrize("distance", DISTANCES.values(), ids=DISTANCES)
def test_few_and_equal_shapes(distance: Distance) -> None:
    """Ties are broken by id; of fewer shapes than asked for, all are answered."""
    equal = SignatureTable(tuple("gbfadce"), np.full((7, 4), 0.5), "r-bihdm")
    found = an_index(equal, distance).query(np.full(4, 0.5), 3)
    assert (found.ids, found.distances.tolist()) == (("a", "b", "c"), [0, 0, 0])
    for n in (1, 2, 12):
        table = a_table(n)
        made = an_index(table, distance)
        for values in 2 * table.values[:3]:
            assert_exact(made.query(values, 1000), made, table, values, 1000)
    values = np.exp([[700.0], [-700.0], [699.0], [-699.0], [-698.0]])
    infinite = an_index(
        SignatureTable(tuple("dceba"), values, "r-bihdm"), DISTANCES["d2"]
    )
    far = infinite.query(np.exp([720.0 - 15]), 4)
    assert (far.ids, far.distances[2]) == (tuple("deab"), np.inf)


def test_what_is_no_index_and_no_query() -> None:
    made = an_index(a_table(5))
    other: Any
    for k in (0, -3, 2.5, True):
        with pytest.raises(
            OptionError, match=f"k must be a whole number of at least 1, got {k}"
        ):
            made.query(np.ones(15), k)  # type: ignore[arg-type]
    for other, message in (
        (
            Signature(np.ones(15), "shape-dna", "3f2a"),
            "same method and options.*got 'shape-dna' '3f2a'",
        ),
        (
            Signature(np.ones(15), "r-bihdm", "77b1"),
            "same method and options.*got 'r-bihdm' '77b1'",
        ),
        (np.r_[np.ones(14), 0.0], "positive and finite, got 0.0"),
        (np.ones(14), r"the query must have shape \(15,\)"),
        ("nobody", "must be one of the 5 ranked shapes, got 'nobody'"),
    ):
        with pytest.raises(InputError, match=message):
            made.query(other)
    with pytest.raises(
        InputError, match="an index needs at least 1 shape, got an empty table"
    ):
        an_index(a_table(0))
    table = a_table(50)
    for digest, n_values, message in (
        ("77b1", 15, r"same options as the table \('3f2a'\), got '77b1'; fit it again"),
        ("3f2a", 9, r"must have shape \(N, 9\)"),
    ):
        whitening = fit_whitening(
            "pca", np.log(table.values[:, :n_values]), options_digest=digest
        )
        with pytest.raises(InputError, match=message):
            SignatureIndex(table, whitening=whitening)


def test_arrays_are_mapped_and_checked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(index, "N_ALL", 0)
    made = an_index(a_table(300), whitening="pca")
    for name, array in made.to_arrays().items():
        np.save(tmp_path / f"{name}.npy", array, allow_pickle=False)
    mapped = {path.stem: np.load(path, mmap_mode="r") for path in tmp_path.iterdir()}
    again = SignatureIndex.from_arrays(mapped)
    assert isinstance(again.points, np.memmap)
    assert again.nearest("T7") == made.nearest("T7")
    with pytest.raises(
        InputError, match="must be made by the same method and options as the table"
    ):
        again.query(Signature(a_table(300).values[0], "wks", "3f2a"))
    for missing in ("ids", "gallery", "whitening_matrix", "distance"):
        less = {name: array for name, array in mapped.items() if name != missing}
        with pytest.raises(InputError, match=missing.removeprefix("whitening_")):
            SignatureIndex.from_arrays(less)
    others = an_index(a_table(21, n_values=14)).to_arrays()
    for name in ("gallery", "ids", "rows", "codes", "mean"):
        with pytest.raises(InputError, match="must be of one table"):
            SignatureIndex.from_arrays(mapped | {name: others[name]})


# --- lower bounds ---------------------------------------------------------------------------------------

N_VALUES = 12


def scan_by_numpy(
    codes: NDArray[np.uint8],
    rows: Rows,
    middle: Singles,
    step: Singles,
    reach: FloatArray,
    blocks: Positions,
    limit: np.float32,
) -> tuple[Rows, Singles]:
    """The reference of the compiled scan, by arrays: distances to cells as to their middles, less `reach`."""
    with np.errstate(over="ignore", invalid="ignore"):
        along = (
            codes[blocks] * step[blocks, :, np.newaxis] + middle[blocks, :, np.newaxis]
        )
        total = (along**2).sum(axis=1, dtype=np.float32)
        most = ((np.sqrt(limit) + reach[blocks]) ** 2).astype(np.float32)
        within = ~(total > most[:, np.newaxis]) & (rows[blocks] != bounds.NO_ROW)
        below = np.maximum(np.sqrt(total) - reach[blocks, np.newaxis], 0) ** 2
    return rows[blocks][within], below[within].astype(np.float32)


Scan = Callable[..., tuple[Rows, Singles]]
SCANS: tuple[Scan, ...] = (scan_by_numpy, bounds.scan)


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


def bounds_of_all(made: LowerBounds, point: FloatArray, scan: Scan) -> FloatArray:
    """(N,) lower bounds; infinite for rows that are in no block."""
    query = (point - made.mean) @ made.axes
    rows, found = scan(*made.cells(query), np.arange(len(made.rows)), np.float32(np.inf))
    every = np.full(int((made.rows >= 0).sum()), np.inf)
    every[rows] = found
    return every


@pytest.mark.parametrize("name", galleries())
def test_no_signature_lies_within_a_distance_and_beyond_its_limit(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By numpy and compiled, with few and all directions, of rows and of whole blocks."""
    gallery = galleries()[name]
    queries = (
        gallery[0],
        gallery[-1],
        gallery[0] + 1e-7,
        np.random.default_rng(6).normal(size=12) * 300,
    )
    for n_leading in (1, 24):
        monkeypatch.setattr(bounds, "N_LEADING", n_leading)
        monkeypatch.setattr(bounds, "SHARE", 0.0)
        made = LowerBounds.of(gallery)
        for query in queries:
            exact = pairwise("log", query[np.newaxis], gallery)[0]
            rounding = (
                index.ROUNDING
                * N_VALUES**2
                * max(np.abs(gallery).max(), np.abs(query).max())
            )
            found = [bounds_of_all(made, query, scan) for scan in SCANS]
            np.testing.assert_allclose(found[1], found[0], rtol=1e-5, atol=1e-6)
            blocks = made._to_blocks((query - made.mean) @ made.axes)
            for radius in np.unique(exact)[:: max(1, len(gallery) // 50)]:
                limit = made._limit(float(radius) * (1 + index.ROUNDING) + rounding)
                within = np.flatnonzero(exact <= radius)
                assert all((each[within] <= limit).all() for each in found)
                for block, rows in zip(blocks, made.rows, strict=True):
                    assert block <= limit or not np.isin(within, rows).any()


def test_where_no_directions_lead_few_signatures_are_compared() -> None:
    gallery = np.random.default_rng(7).normal(size=(3000, 60))
    exact = np.linalg.norm(gallery - gallery[0], axis=1)
    found = LowerBounds.of(gallery).candidates(
        gallery[0], 5, lambda rows: np.sort(exact[rows])[4]
    )
    assert np.isin(np.argsort(exact)[:5], found).all()
    assert len(found) <= bounds.N_LAST * 5


def test_many_neighbours_are_looked_for_beyond_the_first_blocks() -> None:
    """Two blocks have fewer shapes than are few for so many neighbours."""
    gallery = np.random.default_rng(8).normal(size=(5000, 6))
    exact = np.linalg.norm(gallery - gallery[0], axis=1)
    made = LowerBounds.of(gallery)
    k = made.rows.shape[1] // 4
    found = made.candidates(
        gallery[0], k, lambda rows: float(np.sort(exact[rows])[k - 1])
    )
    assert len(made.rows) > bounds.N_BLOCKS and bounds.N_LAST * k > 2 * made.rows.shape[1]
    assert np.isin(np.argsort(exact)[:k], found).all()


def test_queries_beyond_single_precision_leave_nothing_out() -> None:
    gallery = galleries()["spread"]
    made = LowerBounds.of(gallery)
    assert made._limit(1e30) == np.inf
    query = (np.full(N_VALUES, 1e30) - made.mean) @ made.axes
    for scan in SCANS:
        assert np.isfinite(bounds_of_all(made, gallery[3], scan)).all()
        rows, _ = scan(*made.cells(query), np.array([0]), np.float32(np.inf))
        assert sorted(rows) == list(range(len(gallery)))
