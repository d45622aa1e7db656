"""The catalogue gives back what was put in, to several at once; signatures that it lacks are computed."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import closing
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import shapes
from numpy.typing import NDArray

from pcretrieve import Catalogue, PipelineOptions, SignatureIndex
from pcretrieve.catalogue import Content, Record, sqlite
from pcretrieve.catalogue.arrays import (
    SHORTEST_COMPRESSED,
    packed,
    packed_values,
    unpacked,
    unpacked_values,
)
from pcretrieve.descriptors import describe
from pcretrieve.descriptors.describe import with_overlaps
from pcretrieve.errors import CatalogueError, InputError
from pcretrieve.gallery.fitted import index, signatures
from pcretrieve.options import SignatureOptions
from pcretrieve.pipeline.process import process
from pcretrieve.values import Shape

OPTIONS = PipelineOptions()
N_SHAPES = 6


@cache
def egg(number: int) -> Shape:
    """What ingestion makes of an egg, one longer than the other; the last has two surfaces."""
    shape = process(shapes.ellipsoid((1, 1, 1 + number / 5), subdivisions=3), OPTIONS)
    surfaces = (
        (*shape.surfaces, *egg(0).surfaces) if number == N_SHAPES - 1 else shape.surfaces
    )
    return Shape(surfaces, provenance=shape.provenance)


def filled(location: str | Path, options: PipelineOptions = OPTIONS) -> Catalogue:
    store = Catalogue(location, options, create=True)
    for number in range(N_SHAPES):
        name, shape = f"egg{number}", egg(number)
        values = describe(shape, OPTIONS.signature).values
        store.put(
            Record(name, f"/{name}.off", name, steps=shape.provenance),
            Content(shape, values),
        )
    return store


@pytest.fixture
def catalogue(new_location: str) -> Iterator[Catalogue]:
    """A catalogue in each of the stores."""
    with filled(new_location) as store:
        yield store


# --- in and out -----------------------------------------------------------------------------------------


def test_what_is_not_there_is_named(catalogue: Catalogue) -> None:
    for ask in (catalogue.record, catalogue.remove, catalogue.mesh, catalogue.signature):
        with pytest.raises(
            InputError, match=r"holds no shape 'egg9'; `pcretrieve list` names them"
        ):
            ask("egg9")


def test_a_catalogue_is_a_mapping_of_the_shapes_that_did_not_fail(tmp_path: Path) -> None:
    ids = [f"egg{number}" for number in range(N_SHAPES)]
    with filled(tmp_path / "c.sqlite") as store:
        store.put(
            Record(
                "a", "/a.off", "", status="failed", stage="read", error="E", message="no"
            )
        )
        assert isinstance(store, Mapping) and store == store
        assert [*store] == [*store.keys()] == ids and len(store) == N_SHAPES
        assert dict(store) == {
            record.id: record for record in store.records(status="done")
        }
        assert store["egg1"] == store.get("egg1") == store.record("egg1")
        assert "egg1" in store and "a" not in store
        assert store.get("a") is None and store.get("nobody") is None
        with pytest.raises(KeyError, match="shape 'a' failed in read: no"):
            store["a"]
        with pytest.raises(
            InputError, match=r"holds no shape 'egg9'.*; did you mean 'egg"
        ):
            store["egg9"]
        assert store.record("a").status == "failed"


@pytest.mark.parametrize(
    "keep", [(), ("meshes",), ("overlaps",), ("overlaps", "meshes")], ids=str
)
def test_what_options_name_is_stored_and_comes_back(
    keep: tuple[str, ...], tmp_path: Path
) -> None:
    with filled(
        tmp_path / "c.sqlite", OPTIONS.changed(catalogue={"keep": keep})
    ) as store:
        for number in range(N_SHAPES):
            sizes = store.rows.stored_bytes(f"egg{number}")
            parts = {name for name, n_bytes in sizes.items() if n_bytes}
            assert parts == {"record", "signatures", "spectra", "moments", *keep}
            again = store.shape(f"egg{number}", ("spectrum", "overlaps", "mesh"))
            again, shape = with_overlaps(again, "linear"), egg(number)
            for one, other in zip(again.surfaces, shape.surfaces, strict=True):
                assert one.mesh == (other.mesh if "meshes" in keep else None)
                assert (one.spectrum == other.spectrum) is bool(keep)


@pytest.mark.parametrize(
    "options",
    [
        SignatureOptions(n_values=10),
        SignatureOptions(method="shape-dna", scale="absolute"),
        SignatureOptions(method="bihdm", n_values=23, n_modes=40),
        SignatureOptions(method="hks-bow"),
    ],
)
def test_other_descriptors_are_made_from_the_stored_spectra(
    options: SignatureOptions, catalogue: Catalogue
) -> None:
    chosen = catalogue.options.changed(signature=options.model_dump())
    table = signatures(catalogue, options=chosen)
    assert table.kind == options.method
    assert table.digest != signatures(catalogue).digest
    for row, values in enumerate(table.values):
        np.testing.assert_allclose(values, describe(egg(row), options).values, rtol=1e-9)
    assert index(catalogue, options=chosen).nearest("egg2") == SignatureIndex(
        table, chosen.retrieval
    ).nearest("egg2")


RNG = np.random.default_rng(3)
ARRAYS: tuple[NDArray[np.generic], ...] = (
    np.array([0.0, -0.0, np.inf, -np.inf, np.nan, 5e-324, 1.7e308, -1.0]),
    RNG.normal(size=(2, 40, 41)),
    np.ones(SHORTEST_COMPRESSED // 8 - 1),
    RNG.integers(0, 2**31 - 1, size=(500, 3)).astype(np.int32),
    RNG.normal(size=(90, 90))[:, ::2],
    RNG.normal(size=700).astype(">f8"),
    np.empty((0, 3)),
    np.array(3.0),
    np.arange(-128, 128).astype(np.int8),
)


def test_every_bit_of_an_array_comes_back_and_a_changed_one_is_noticed() -> None:
    for found, given in zip(unpacked(packed(ARRAYS), len(ARRAYS)), ARRAYS, strict=True):
        assert found.shape == given.shape
        assert found.dtype == given.dtype.newbyteorder("=")
        assert found.tobytes() == np.asarray(given, found.dtype).tobytes()
    for pieces, unpack in (
        (packed([np.arange(50.0)]), lambda blob: unpacked(blob, 1)),
        (packed([RNG.normal(size=(30, 30))]), lambda blob: unpacked(blob, 1)),
        (packed_values(RNG.normal(size=23)), lambda blob: unpacked_values(blob, 1, 23)),
    ):
        for position in (0, 5, 8, 100, -5, -1):
            blob = bytearray(pieces)
            blob[position] ^= 16
            with pytest.raises(ValueError, match="checksum"):
                unpack(bytes(blob))
    with pytest.raises(ValueError, match="it declares more than 16777216 bytes in"):
        unpacked(packed([np.zeros(2_500_000)]), 1)


# --- several at once ------------------------------------------------------------------------------------


def test_a_second_writer_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sqlite, "LOCK_TIMEOUT", 0.05)
    with (
        filled(tmp_path / "eggs.sqlite") as store,
        closing(sqlite3.connect(store.location)) as writer,
    ):
        writer.execute("BEGIN IMMEDIATE")
        words = "is locked by another process: wait until that has finished"
        with (
            Catalogue(store.location) as other,
            pytest.raises(CatalogueError, match=words),
        ):
            other.remove("egg0")
