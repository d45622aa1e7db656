"""Stored indexes belong to a state of the catalogue, and give the results of newly computed indexes."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import shapes

from pcretrieve import Catalogue, PipelineOptions, SignatureIndex
from pcretrieve.catalogue import Content, Record
from pcretrieve.catalogue import cache as gallery
from pcretrieve.descriptors import describe
from pcretrieve.pipeline.process import process
from pcretrieve.values import Shape

OPTIONS = PipelineOptions().changed(signature={"method": "r-bihdm", "n_values": 59})
WHITENINGS = ("none", "resolution", "neighbours", "pca", "within-class")
N_SHAPES = 40


@cache
def egg() -> Shape:
    return process(shapes.icosphere(3), OPTIONS)


def put(store: Catalogue, number: int) -> None:
    """A shape that is no egg's, but somebody else's signature."""
    rng = np.random.default_rng(number)
    values = describe(egg(), OPTIONS.signature).values * np.exp(rng.normal(size=59) * 0.3)
    record = Record(f"s{number:03}", f"/s{number:03}.off", f"hash{number}", f"kind{number % 5}")
    store.put(record, Content(egg(), values))


@pytest.fixture
def catalogue(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Catalogue]:
    """One that is small, but for which indexes are kept."""
    monkeypatch.setattr(gallery, "SMALLEST_KEPT", 1)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    with Catalogue(tmp_path / "c.sqlite", OPTIONS, create=True) as store:
        for number in range(N_SHAPES):
            put(store, number)
        yield store


def asked(whitening: str = "none", distance: str = "log") -> PipelineOptions:
    """Options by which the stored values are compared."""
    return OPTIONS.changed(
        retrieval={"whitening": whitening, "distance": distance}, signature={"scale": "area"}
    )


def fresh(store: Catalogue, options: PipelineOptions) -> SignatureIndex:
    """An index of the table that is not stored."""
    return SignatureIndex(store.signatures(options), options.retrieval, whitening=store.whitening(options))


def kept(store: Catalogue) -> list[Path]:
    folder = Path(store.location).with_name("c.sqlite.gallery")
    return sorted(folder.iterdir()) if folder.exists() else []


def assert_same(index: SignatureIndex, store: Catalogue, options: PipelineOptions) -> None:
    anew = fresh(store, options)
    for values in store.signatures(options).values[::7]:
        for query in (values, values * 1.05):
            assert index.query(query, 12) == anew.query(query, 12)


@pytest.mark.parametrize(("distance", "whitening"), [("log", one) for one in WHITENINGS] + [("d1", "none")])
def test_an_index_that_was_kept_answers_as_one_made_anew(
    distance: str, whitening: str, catalogue: Catalogue
) -> None:
    options = asked(whitening, distance)
    assert_same(catalogue.index(options), catalogue, options)
    assert len(kept(catalogue)) == 1
    with Catalogue(catalogue.location) as other:
        statements: list[str] = []
        other.database._connection.set_trace_callback(statements.append)
        index = other.index(options)
        assert other.whitening(options) == index.whitening
        assert not [text for text in statements if "signatures" in text], "it was computed again"
        assert_same(index, catalogue, options)


def test_what_others_add_and_remove_is_noticed(catalogue: Catalogue) -> None:
    before = catalogue.index()
    with Catalogue(catalogue.location) as other:
        put(other, N_SHAPES)
        assert list(catalogue.index().ids) == [*before.ids, f"s{N_SHAPES:03}"]
        other.remove("s003")
        assert "s003" not in catalogue.index().ids
    assert_same(catalogue.index(asked()), catalogue, asked())


def test_a_copy_that_is_restored_has_not_the_index_of_the_state_after_it(
    catalogue: Catalogue, tmp_path: Path
) -> None:
    """Both have seen as many writes."""
    catalogue.close()
    shutil.copy(catalogue.location, tmp_path / "backup")
    with Catalogue(catalogue.location) as store:
        put(store, N_SHAPES)
        store.index(asked())
    shutil.copy(tmp_path / "backup", catalogue.location)
    with Catalogue(catalogue.location) as store:
        put(store, N_SHAPES + 1)
        assert "s041" in store.index(asked()).nearest("s041", 50).ids
        assert_same(store.index(asked()), store, asked())


@pytest.mark.parametrize("array", ["gallery", "id_text"])
@pytest.mark.parametrize("damage", ["truncated", "missing", "garbage", "one bit"])
def test_one_that_is_damaged_is_made_anew(damage: str, array: str, catalogue: Catalogue) -> None:
    catalogue.index(asked())
    (folder,) = kept(catalogue)
    (file,) = folder.glob(f"{array}.npy")
    data = file.read_bytes()
    file.unlink()  # the index above has the old one mapped
    if damage == "one bit":
        file.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    elif damage != "missing":
        file.write_bytes(data[: len(data) // 2] if damage == "truncated" else b"no array" * 100)
    with Catalogue(catalogue.location) as other:
        assert_same(other.index(asked()), catalogue, asked())
    with Catalogue(catalogue.location) as other:
        assert isinstance(other.index(asked()).to_arrays()["gallery"], np.ndarray)
    assert kept(catalogue) == [folder]
