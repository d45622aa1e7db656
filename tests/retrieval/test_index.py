"""The index against brute force, for every distance and whitening."""

import pickle
from pathlib import Path

import numpy as np
import pytest

from pcretrieve.errors import InputError, OptionError
from pcretrieve.options import RetrievalOptions
from pcretrieve.retrieval import (
    DISTANCES,
    SignatureIndex,
    filtering,
    fit_whitening,
    log_signatures,
    pairwise,
    whitened,
)
from pcretrieve.retrieval.filtering import Filter
from pcretrieve.retrieval.names import Names
from pcretrieve.values import FloatArray, Signature, SignatureTable


def a_table(n: int, *, seed: int = 0, n_values: int = 15, copies: int = 0) -> SignatureTable:
    """Classes of five, in a shuffled order of ids; the last `copies` rows repeat the first ones."""
    rng = np.random.default_rng(seed)
    scale = np.geomspace(1, 0.05, n_values)
    centres = rng.normal(size=(n // 5 + 1, n_values)) * scale
    logs = centres[np.arange(n) // 5] + 0.3 * scale * rng.normal(size=(n, n_values)) - 3
    if copies:
        logs[-copies:] = logs[:copies]
    ids = tuple(f"T{number}" for number in rng.permutation(n))
    labels = tuple(f"class {number // 5}" for number in range(n))
    return SignatureTable(ids, np.exp(logs), "r-bihdm", "3f2a", labels)


def by_brute_force(
    index: SignatureIndex, table: SignatureTable, values: FloatArray, k: int
) -> tuple[tuple[str, ...], list[float]]:
    """The first k of all shapes, sorted by (distance, id)."""
    query, gallery = (index.whitening.apply(log_signatures(v)) for v in (values[np.newaxis], table.values))
    distances = pairwise(index.distance, query, gallery)[0]
    ranked = sorted(zip(distances.tolist(), table.ids, strict=True))[:k]
    return tuple(shape for _, shape in ranked), [distance for distance, _ in ranked]


@pytest.mark.parametrize("whitening", ["none", "pca", "within-class"])
@pytest.mark.parametrize("distance", DISTANCES.own)
@pytest.mark.parametrize("seed", range(3))
def test_agrees_with_brute_force(
    distance: str, whitening: str, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(filtering, "N_ALL", 0)
    table = a_table(300, seed=seed, copies=60)
    index = SignatureIndex(table, RetrievalOptions(distance=distance, whitening=whitening))
    rng = np.random.default_rng(seed + 100)
    near = table.values[:15] * np.exp(0.1 * rng.normal(size=(15, 15)))
    outside = np.exp(rng.normal(size=(15, 15)) * 8)
    far_outside = np.exp(rng.uniform(-300, 300, size=(5, 15)))
    for values in (*table.values[:15], *near, *outside, *far_outside):
        for k in (1, 10, 299):
            found = index.query(values, k)
            ids, distances = by_brute_force(index, table, values, k)
            assert found.distances.tolist() == distances
            assert found.ids == ids


@pytest.mark.parametrize("distance", DISTANCES.own)
def test_leaves_most_of_a_gallery_out(distance: str) -> None:
    """The lower bound is worth having: few shapes are measured exactly."""
    table = a_table(3000)
    index = SignatureIndex(table, RetrievalOptions(distance=distance))
    points = index.whitening.apply(log_signatures(table.values[:20]))
    measured = [len(index.contents.filter.candidates(point[np.newaxis], 5)) for point in points]
    assert np.median(measured) < 100


@pytest.mark.parametrize("distance", DISTANCES.own)
def test_ties_are_broken_by_id(distance: str) -> None:
    values = np.full((7, 4), 0.5)
    table = SignatureTable(tuple("gbfadce"), values, "r-bihdm")
    found = SignatureIndex(table, RetrievalOptions(distance=distance)).query(values[0], 3)
    assert found.ids == ("a", "b", "c")
    assert (found.distances == 0).all()


@pytest.mark.parametrize("whitening", ["none", "pca"])
@pytest.mark.parametrize("distance", DISTANCES.own)
def test_two_shapes(distance: str, whitening: str) -> None:
    table = a_table(2)
    index = SignatureIndex(table, RetrievalOptions(distance=distance, whitening=whitening))
    for values in table.values:
        found = index.query(values, 10)
        assert (found.ids, found.distances.tolist()) == by_brute_force(index, table, values, 10)
        assert found.distances[0] == 0


@pytest.mark.parametrize("distance", DISTANCES.own)
def test_one_shape(distance: str) -> None:
    table = a_table(1)
    found = SignatureIndex(table, RetrievalOptions(distance=distance)).query(table.values[0] * 2, 10)
    assert found.ids == table.ids
    assert found.distances[0] > 0


def test_one_shape_cannot_be_whitened() -> None:
    with pytest.raises(InputError, match="needs at least 2 distinct shapes"):
        SignatureIndex(a_table(1), RetrievalOptions(whitening="pca"))


@pytest.mark.parametrize("distance", DISTANCES.own)
def test_all_shapes_for_a_k_beyond_them(distance: str) -> None:
    table = a_table(12)
    found = SignatureIndex(table, RetrievalOptions(distance=distance)).query(table.values[3], 1000)
    assert sorted(found.ids) == sorted(table.ids)
    assert (np.diff(found.distances) >= 0).all()


def test_infinite_distances_are_ranked_by_id() -> None:
    values = np.exp([[700.0], [-700.0], [699.0], [-699.0], [-698.0]])
    index = SignatureIndex(SignatureTable(tuple("dceba"), values, "r-bihdm"), RetrievalOptions(distance="d2"))
    point = np.exp([720.0 - 15])
    assert (index.query(point, 4).ids, index.query(point, 4).distances[2]) == (tuple("deab"), np.inf)


@pytest.mark.parametrize("distance", DISTANCES.own)
@pytest.mark.parametrize("n_leading", [1, 15, 100])
def test_the_leading_directions_change_no_answer(
    distance: str, n_leading: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(filtering, "N_ALL", 0)
    points = log_signatures(a_table(200).values)
    few = Filter.of(distance, points, n_leading)
    for point in points[:10, np.newaxis]:
        exact = pairwise(distance, point, points)[0]
        assert set(np.argsort(exact, kind="stable")[:10]) <= set(few.candidates(point, 10))


def test_many_queries_are_the_queries_one_by_one() -> None:
    table = a_table(50)
    index = SignatureIndex(table, RetrievalOptions(whitening="pca"))
    for values, found in zip(table.values, index.query_many(table.values, 4), strict=True):
        assert found.ids == index.query(values, 4).ids


def test_a_signature_is_as_good_as_its_values() -> None:
    table = a_table(50)
    index = SignatureIndex(table, RetrievalOptions(whitening="none"))
    signature = Signature(table.values[5], "r-bihdm", "3f2a")
    assert index.query(signature).ids == index.query(table.values[5]).ids
    assert index.query(signature).ids[0] == table.ids[5]


def test_a_whitening_fitted_before_serves_as_well() -> None:
    table = a_table(50)
    whitening = fit_whitening("pca", log_signatures(table.values), options_digest=table.digest)
    before = SignatureIndex(table, whitening=whitening)
    now = SignatureIndex(table, RetrievalOptions(whitening="pca"))
    assert before.whitening.digest == now.whitening.digest
    assert before.query(table.values[0]).ids == now.query(table.values[0]).ids


@pytest.mark.parametrize("whitening", ["none", "neighbours"])
def test_the_order_of_the_table_does_not_matter(whitening: str) -> None:
    table, options = a_table(80, copies=10), RetrievalOptions(whitening=whitening)
    order = np.random.default_rng(4).permutation(80)
    shuffled = SignatureTable(tuple(table.ids[i] for i in order), table.values[order], "r-bihdm", "3f2a")
    for values in table.values[:10]:
        before, after = (SignatureIndex(each, options).query(values).ids for each in (table, shuffled))
        assert before == after


@pytest.mark.parametrize("whitening", ["none", "pca"])
@pytest.mark.parametrize("distance", DISTANCES.own)
def test_an_index_that_was_pickled_answers_as_before(distance: str, whitening: str) -> None:
    table = a_table(200, copies=20)
    index = SignatureIndex(table, RetrievalOptions(distance=distance, whitening=whitening))
    copy = pickle.loads(pickle.dumps(index))
    assert copy.whitening == index.whitening
    for values in table.values[:10]:
        assert copy.query(values) == index.query(values)


def test_neighbours_cannot_be_changed() -> None:
    found = SignatureIndex(a_table(12)).query(a_table(12).values[0], 3)
    for one in (found, pickle.loads(pickle.dumps(found))):
        with pytest.raises(ValueError, match="read-only"):
            one.distances[0] = 1


def test_length() -> None:
    assert len(SignatureIndex(a_table(12))) == 12


def test_a_whitening_that_is_not_fitted_must_be_made_before() -> None:
    with pytest.raises(OptionError, match="'resolution' is not fitted to shapes: see resolution_whitening"):
        SignatureIndex(a_table(5), RetrievalOptions(whitening="resolution"))


def test_an_empty_table() -> None:
    with pytest.raises(InputError, match="an index needs at least 1 shape, got an empty table"):
        SignatureIndex(SignatureTable((), np.zeros((0, 5)), "r-bihdm"))


def test_a_whitening_of_other_signatures() -> None:
    whitening = fit_whitening("pca", log_signatures(a_table(50).values), options_digest="77b1")
    with pytest.raises(InputError, match=r"same options as the table \('3f2a'\), got '77b1'; fit it again"):
        SignatureIndex(a_table(50), whitening=whitening)
    shorter = fit_whitening("pca", log_signatures(a_table(50, n_values=9).values), options_digest="3f2a")
    with pytest.raises(InputError, match=r"must have shape \(N, 9\)"):
        SignatureIndex(a_table(50), whitening=shorter)


@pytest.mark.parametrize("k", [0, -3, 2.5, True])
def test_a_number_of_neighbours_that_is_none(k: int) -> None:
    with pytest.raises(OptionError, match=f"k must be a whole number of at least 1, got {k}"):
        SignatureIndex(a_table(5)).query(np.ones(15), k)


@pytest.mark.parametrize(("kind", "digest"), [("shape-dna", "3f2a"), ("r-bihdm", "77b1")])
def test_a_signature_of_another_make(kind: str, digest: str) -> None:
    with pytest.raises(InputError, match=f"same method and options.*got '{kind}' '{digest}'"):
        SignatureIndex(a_table(5)).query(Signature(np.ones(15), kind, digest))


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf])
def test_values_that_are_no_signature(bad: float) -> None:
    values = np.ones(15)
    values[3] = bad
    with pytest.raises(InputError, match=f"positive and finite, got {bad}"):
        SignatureIndex(a_table(5)).query(values)


@pytest.mark.parametrize("shape", [(14,), (1, 15), ()])
def test_values_of_another_shape(shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match=r"the query must have shape \(15,\)"):
        SignatureIndex(a_table(5)).query(np.ones(shape))


# --- as arrays ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("whitening", ["none", "pca", "within-class"])
@pytest.mark.parametrize("distance", DISTANCES.own)
def test_arrays_give_the_answers_of_the_index(
    distance: str, whitening: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Mapped into memory too; a few of them are files that are read as a whole."""
    monkeypatch.setattr(filtering, "N_ALL", 0)
    table = a_table(300, copies=20)
    index = SignatureIndex(table, RetrievalOptions(distance=distance, whitening=whitening))
    for name, array in index.to_arrays().items():
        np.save(tmp_path / f"{name}.npy", array, allow_pickle=False)
    mapped = {path.stem: np.load(path, mmap_mode="r") for path in tmp_path.iterdir()}
    assert isinstance(mapped["gallery"], np.memmap)
    again = SignatureIndex.from_arrays(mapped)
    assert len(again) == len(index)
    for values in (*table.values[:10], *table.values[:10] * 1.1):
        assert again.query(values, 7) == index.query(values, 7)
    with pytest.raises(InputError, match="must be made by the same method and options as the table"):
        again.query(Signature(table.values[0], "wks", "3f2a"))


@pytest.mark.parametrize("missing", ["id_text", "gallery", "whitening_matrix", "distance"])
def test_arrays_that_are_missing_are_named(missing: str) -> None:
    arrays = SignatureIndex(a_table(20)).to_arrays()
    del arrays[missing]
    with pytest.raises(InputError, match=missing.removeprefix("whitening_")):
        SignatureIndex.from_arrays(arrays)


@pytest.mark.parametrize("name", ["gallery", "id_ends", "rows", "codes", "mean"])
def test_arrays_of_two_tables_are_no_index(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(filtering, "N_ALL", 0)
    arrays = SignatureIndex(a_table(20)).to_arrays()
    arrays[name] = SignatureIndex(a_table(21, n_values=14)).to_arrays()[name]
    with pytest.raises(InputError, match="must be of one table"):
        SignatureIndex.from_arrays(arrays)


def test_a_shape_of_the_table_is_asked_for_by_its_id() -> None:
    table = a_table(50)
    index = SignatureIndex(table, RetrievalOptions(whitening="pca"))
    for shape_id, values in zip(table.ids, table.values, strict=True):
        assert index.nearest(shape_id, 5) == index.query(values, 5)
    with pytest.raises(InputError, match="must be one of the 50 ranked shapes, got 'nobody'"):
        index.nearest("nobody")
    with pytest.raises(OptionError, match="k must be a whole number"):
        index.nearest("T3", 0)


def test_long_tables_are_whitened_in_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    table = a_table(100)
    whole = SignatureIndex(table, RetrievalOptions(whitening="pca")).to_arrays()["gallery"]
    monkeypatch.setattr(whitened, "CHUNK", 7)
    blocks = SignatureIndex(table, RetrievalOptions(whitening="pca")).to_arrays()["gallery"]
    np.testing.assert_array_equal(blocks, whole)


@pytest.mark.parametrize("names", [[], ["a"], ["", "a", "ab", "b", "\u96ea", "\U0001f600"]])
def test_names_come_back(names: list[str]) -> None:
    stored = Names.of(names)
    assert list(stored) == stored[:] == names
    assert [stored.index(name) for name in names] == list(range(len(names)))
    assert all(name in stored for name in names)
    for other in ("aa", "zzz", "\U0001f601"):
        assert other not in stored
        with pytest.raises(ValueError, match="is not among the names"):
            stored.index(other)
    for beyond in (len(names), -len(names) - 1):
        with pytest.raises(IndexError):
            stored[beyond]


@pytest.mark.parametrize("distance", ["log", "d1", "d2"])
def test_distances_between_some_shapes_are_those_of_the_gallery(distance: str) -> None:
    values = np.exp(np.random.default_rng(0).normal(size=(60, 5)))
    names = tuple(f"{row:02}" for row in range(60))
    options = RetrievalOptions.model_validate({"distance": distance, "whitening": "none"})
    index = SignatureIndex(SignatureTable(names, values, "x"), options)
    chosen = [41, 3, 17]
    ((_, distances),) = index.blocks(np.array(chosen))
    np.testing.assert_array_equal(index.between([names[row] for row in chosen]), distances[:, chosen])
