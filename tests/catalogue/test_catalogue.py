"""The catalogue gives back what was put in, to several at once; signatures and indexes it lacks are computed.

Stored indexes belong to a state of the catalogue, and give the results of newly computed indexes.
"""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import shapes
from numpy.typing import NDArray

from pcretrieve import Catalogue, PipelineOptions, SignatureIndex
from pcretrieve.catalogue import Content, Record, cache as gallery, sqlite
from pcretrieve.catalogue.arrays import (
    SHORTEST_COMPRESSED,
    packed,
    packed_values,
    unpacked,
    unpacked_values,
)
from pcretrieve.descriptors import describe
from pcretrieve.errors import CatalogueError, InputError
from pcretrieve.options import SignatureOptions
from pcretrieve.pipeline.process import process
from pcretrieve.retrieval import coordinates, fit_whitening
from pcretrieve.values import Shape

OPTIONS = PipelineOptions()
N_SHAPES = 6


@cache
def egg(number: int) -> Shape:
    """What ingestion makes of an egg, one longer than the other; the last has two surfaces."""
    shape = process(shapes.ellipsoid((1, 1, 1 + number / 5), subdivisions=3), OPTIONS)
    surfaces = (*shape.surfaces, *egg(0).surfaces) if number == N_SHAPES - 1 else shape.surfaces
    return Shape(surfaces, provenance=shape.provenance)


def filled(location: str | Path, options: PipelineOptions = OPTIONS) -> Catalogue:
    store = Catalogue(location, options, create=True)
    for number in range(N_SHAPES):
        name, shape = f"egg{number}", egg(number)
        values = describe(shape, OPTIONS.signature).values
        store.put(
            Record(name, f"/{name}.off", name, steps=shape.provenance), Content(shape, values)
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
        with pytest.raises(InputError, match="holds no shape 'egg9'; `pcretrieve list` names them"):
            ask("egg9")


@pytest.mark.parametrize("keep", [(), ("meshes",), ("overlaps",), ("overlaps", "meshes")], ids=str)
def test_what_options_name_is_stored_and_comes_back(keep: tuple[str, ...], tmp_path: Path) -> None:
    with filled(tmp_path / "c.sqlite", OPTIONS.changed(catalogue={"keep": keep})) as store:
        for number in range(N_SHAPES):
            sizes = store.stored_bytes(f"egg{number}")
            parts = {name for name, n_bytes in sizes.items() if n_bytes}
            assert parts == {"record", "signatures", "spectra", "moments", *keep}
            again, shape = (
                store.shape(f"egg{number}", ("spectrum", "overlaps", "mesh")),
                egg(number),
            )
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
    table = catalogue.signatures(chosen)
    assert table.kind == options.method
    assert table.digest != catalogue.signatures().digest
    for row, values in enumerate(table.values):
        np.testing.assert_allclose(values, describe(egg(row), options).values, rtol=1e-9)
    assert catalogue.index(chosen).nearest("egg2") == SignatureIndex(
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
        with Catalogue(store.location) as other, pytest.raises(CatalogueError, match=words):
            other.remove("egg0")


# --- stored indexes -------------------------------------------------------------------------------------

FEW = PipelineOptions().changed(signature={"method": "r-bihdm", "n_values": 59})
N_INDEXED = 40


def put_other(store: Catalogue, number: int) -> None:
    """An egg with somebody else's signature."""
    change = np.exp(np.random.default_rng(number).normal(size=59) * 0.3)
    values = describe(egg(0), FEW.signature).values * change
    label = f"kind{number % 5}"
    store.put(
        Record(f"s{number:03}", f"/s{number:03}.off", f"h{number}", label), Content(egg(0), values)
    )


@pytest.fixture
def indexed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Catalogue]:
    """A small catalogue of which indexes are stored all the same."""
    monkeypatch.setattr(gallery, "SMALLEST_KEPT", 1)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    with Catalogue(tmp_path / "c.sqlite", FEW, create=True) as store:
        for number in range(N_INDEXED):
            put_other(store, number)
        yield store


def asked(whitening: str = "none", distance: str = "log") -> PipelineOptions:
    """Options by which the stored values are compared."""
    retrieval = {"whitening": whitening, "distance": distance}
    return FEW.changed(retrieval=retrieval, signature={"scale": "area"})


def kept(store: Catalogue) -> list[Path]:
    folder = store.cache.folder
    return sorted(folder.iterdir()) if folder is not None and folder.exists() else []


def assert_same(index: SignatureIndex, store: Catalogue, options: PipelineOptions) -> None:
    """An index is the one of the present shapes, whatever was stored or fitted before."""
    table, kind = store.signatures(options), options.retrieval.whitening
    whitening = None
    if kind in ("pca", "within-class"):
        logs = coordinates(table.values, "logarithms")
        whitening = fit_whitening(kind, logs, table.labels, options_digest=table.digest)
    assert store.whitening(options) == (whitening or index.whitening)
    anew = SignatureIndex(table, options.retrieval, whitening=whitening or index.whitening)
    for values in table.values[::7]:
        for query in (values, values * 1.05):
            assert index.query(query, 12) == anew.query(query, 12)


WHITENINGS = ("none", "people", "neighbours", "pca", "within-class")


@pytest.mark.parametrize(
    ("distance", "whitening"), [("log", one) for one in WHITENINGS] + [("d1", "none")]
)
def test_an_index_that_was_kept_answers_as_one_made_anew(
    distance: str, whitening: str, indexed: Catalogue
) -> None:
    options = asked(whitening, distance)
    assert_same(indexed.index(options), indexed, options)
    assert len(kept(indexed)) == 1
    with Catalogue(indexed.location) as other:
        statements: list[str] = []
        other.database._connection.set_trace_callback(statements.append)
        index = other.index(options)
        assert other.whitening(options) == index.whitening
        assert not [text for text in statements if "signatures" in text], "it was computed again"
        assert_same(index, indexed, options)


def test_what_others_add_remove_and_label_is_noticed(
    indexed: Catalogue, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = indexed.index()
    places = indexed.cache.places(before.points, indexed.revision())
    monkeypatch.delattr(gallery, "plane_map")  # a map is not computed again
    np.testing.assert_array_equal(indexed.cache.places(before.points, indexed.revision()), places)
    with Catalogue(indexed.location) as other:
        put_other(other, N_INDEXED)
        assert list(indexed.index().ids) == [*before.ids, f"s{N_INDEXED:03}"]
        assert len(kept(indexed)) == 1, "the map of before is gone"
        other.remove("s003")
        assert "s003" not in indexed.index().ids
        for kind in ("pca", "within-class"):
            assert_same(indexed.index(asked(kind)), indexed, asked(kind))
        fitted = indexed.whitening(asked("within-class"))
        other.revise(labels={"/s004.off": "kind0"})
        assert indexed.whitening(asked("within-class")) != fitted
    assert_same(indexed.index(asked("within-class")), indexed, asked("within-class"))


@pytest.mark.parametrize("damage", ["missing", "one bit"])
def test_one_that_is_damaged_is_found_and_made_anew(damage: str, indexed: Catalogue) -> None:
    indexed.index(asked())
    (folder,) = kept(indexed)
    file = folder / "gallery.npy"
    data = file.read_bytes()
    file.unlink()  # the index above has the old one mapped
    if damage == "one bit":
        file.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    assert [path for path, _ in indexed.cache.faults()] == [folder]
    with Catalogue(indexed.location) as other:
        assert_same(other.index(asked()), indexed, asked())
    assert kept(indexed) == [folder]
    assert [*indexed.cache.faults()] == []


def photographs(folder: Path) -> list[Path]:
    """Folders of a reader, one of which is old, one named like an index and one like an unfinished one."""
    mine = [folder / name for name in ("photos", "0" * 16 + "-" + "1" * 16, ".unfinished-photos")]
    for each in mine:
        each.mkdir(parents=True)
        (each / "photo.jpg").write_text("a photograph")
        os.utime(each, (0, 0))
    return mine


@pytest.mark.parametrize("target", [".", "..", "an absolute path", "a real folder"])
def test_no_folder_beside_a_catalogue_of_somebody_else_is_removed(
    target: str, indexed: Catalogue, tmp_path: Path
) -> None:
    beside = Path(indexed.location).with_name("c.sqlite.gallery")
    mine = photographs(tmp_path)
    if target == "a real folder":
        mine += photographs(beside)
    else:
        beside.symlink_to(tmp_path if target == "an absolute path" else target)
    indexed.index(asked())
    put_other(indexed, N_INDEXED)
    indexed.index(asked())
    assert len(kept(indexed)) == 1
    assert [each for each in mine if not (each / "photo.jpg").exists()] == []


@pytest.mark.parametrize("target", [".", "..", "an absolute path"])
def test_what_a_link_in_the_cache_leads_to_is_not_removed(
    target: str, indexed: Catalogue, tmp_path: Path
) -> None:
    mine = photographs(tmp_path / "mine")
    (mine[1] / gallery.CHECKSUMS).write_text("{}")  # like an index of another state
    indexed.index(asked())
    (index,) = kept(indexed)
    links = [index.with_name(name) for name in ("2" * 16 + "-" + "3" * 16, ".unfinished-link")]
    for link in links:
        link.symlink_to(mine[1] if target == "an absolute path" else target)
        os.utime(link, (0, 0), follow_symlinks=False)
    mine += photographs(index.parent)
    put_other(indexed, N_INDEXED)
    indexed.index(asked())
    assert [
        each for each in mine if each.name[0] != "." and not (each / "photo.jpg").exists()
    ] == []
    assert [link for link in links if not link.is_symlink()] == []
