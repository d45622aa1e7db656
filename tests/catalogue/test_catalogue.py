"""The catalogue gives back what was put in, to several at once; what it lacks is computed."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import shapes

from pcretrieve import Catalogue, PipelineOptions
from pcretrieve.catalogue import Content, Record, sqlite
from pcretrieve.descriptors import describe
from pcretrieve.errors import CatalogueError, InputError
from pcretrieve.options import SignatureOptions
from pcretrieve.pipeline.process import process
from pcretrieve.retrieval import coordinates, fit_whitening
from pcretrieve.values import Need, Shape

OPTIONS = PipelineOptions()
N_SHAPES = 6


@cache
def egg(number: int) -> Shape:
    """What ingestion makes of an egg, one longer than the other."""
    shape = process(shapes.ellipsoid((1, 1, 1 + number / 5), subdivisions=3), OPTIONS)
    return replace(shape, surfaces=tuple(replace(surface, eigenpairs=None) for surface in shape.surfaces))


def whitened(kind: str) -> PipelineOptions:
    return OPTIONS.changed(retrieval={"whitening": kind})


@cache
def content(number: int) -> Content:
    shape = egg(number)
    return Content(shape, describe(shape, OPTIONS.signature).values)


def record(number: int) -> Record:
    label = "round" if number < N_SHAPES // 2 else "long"
    steps = content(number).shape.provenance
    return Record(f"egg{number}", f"/eggs/egg{number}.off", f"hash{number}", label, steps=steps)


def filled(location: str) -> Catalogue:
    store = Catalogue(location, create=True)
    for number in range(N_SHAPES):
        store.put(record(number), content(number))
    return store


@pytest.fixture
def catalogue(new_location: str) -> Iterator[Catalogue]:
    """A catalogue in each of the stores."""
    with filled(new_location) as store:
        yield store


@pytest.fixture
def in_file(tmp_path: Path) -> Iterator[Catalogue]:
    with filled(str(tmp_path / "eggs.sqlite")) as store:
        yield store


# --- in and out -----------------------------------------------------------------------------------------


def test_what_is_not_there_is_named(catalogue: Catalogue) -> None:
    for ask in (catalogue.record, catalogue.remove, catalogue.mesh, catalogue.signature):
        with pytest.raises(InputError, match="holds no shape 'egg9'; `pcretrieve list` names them"):
            ask("egg9")


def test_everything_outlives_the_process_in_one_file(in_file: Catalogue) -> None:
    before = in_file.records()
    in_file.close()
    assert [str(path) for path in Path(in_file.location).parent.iterdir()] == [in_file.location]
    with Catalogue(in_file.location) as again:
        assert again.records() == before
        assert len(again) == N_SHAPES


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
    table = catalogue.signatures(catalogue.options.changed(signature=options.model_dump()))
    assert table.kind == options.method
    assert table.digest != catalogue.signatures().digest
    for row, values in enumerate(table.values):
        np.testing.assert_allclose(values, describe(egg(row), options).values, rtol=1e-9)


# --- whitening ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["pca", "within-class"])
def test_a_whitening_is_fitted_anew_once_the_shapes_change(kind: str, catalogue: Catalogue) -> None:
    def fitted() -> bytes:
        """Also by other processes: the catalogue always gives the results of its present shapes."""
        table = catalogue.signatures(whitened(kind))
        expected = fit_whitening(
            kind, coordinates(table.values), table.labels, options_digest=table.digest
        ).to_arrays()
        for _ in ("fitted", "read back"):
            answer = catalogue.whitening(whitened(kind)).to_arrays()
            for name, values in expected.items():
                np.testing.assert_array_equal(answer[name], values)
        return np.asarray(expected["matrix"]).tobytes()

    first = fitted()
    catalogue.remove("egg5")
    second = fitted()
    catalogue.put(record(5), content(0))
    third = fitted()
    assert len({first, second, third}) == 3


# --- several at once ------------------------------------------------------------------------------------


def test_readers_see_the_last_whole_state_while_somebody_writes(in_file: Catalogue) -> None:
    with closing(sqlite3.connect(in_file.location)) as writer:
        writer.execute("BEGIN IMMEDIATE")
        writer.execute("DELETE FROM shapes")
        with Catalogue(in_file.location) as reader:
            assert len(reader) == N_SHAPES
        writer.commit()
    assert len(in_file) == 0


def test_two_writers_take_turns_or_say_so(in_file: Catalogue, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sqlite, "LOCK_TIMEOUT", 0.05)
    with closing(sqlite3.connect(in_file.location)) as writer, Catalogue(in_file.location) as other:
        writer.execute("BEGIN IMMEDIATE")
        with pytest.raises(
            CatalogueError, match="is locked by another process: wait until that has finished"
        ):
            other.remove("egg0")
        writer.rollback()
        other.remove("egg0")
    assert len(in_file) == N_SHAPES - 1


# --- parts that options name ----------------------------------------------------------------------------

NEEDS: tuple[Need, ...] = ("spectrum", "overlaps", "mesh")


def options_keeping(*parts: str) -> PipelineOptions:
    return PipelineOptions().changed(catalogue={"keep": parts})


@cache
def eggs(element: str = "linear") -> tuple[Shape, ...]:
    """What processing makes of three eggs, the last of which has two surfaces."""
    options = PipelineOptions().changed(spectral={"element": element})
    first, second = (process(shapes.ellipsoid((1, 1, c), subdivisions=3), options) for c in (1.2, 1.5))
    both = Shape((*first.surfaces, *second.surfaces), provenance=first.provenance)
    return first, second, both


def keeping(path: Path, options: PipelineOptions) -> Catalogue:
    store = Catalogue(path, options, create=True)
    for number, shape in enumerate(eggs(options.spectral.element)):
        record = Record(f"egg{number}", f"/egg{number}", f"hash{number}", "egg", steps=shape.provenance)
        store.put(record, Content(shape, describe(shape, options.signature).values))
    return store


def stored_parts(store: Catalogue) -> set[str]:
    sizes = [store.stored_bytes(record.id) for record in store.records()]
    return {name for size in sizes for name, n_bytes in size.items() if n_bytes}


ALWAYS = {"record", "signatures", "spectra", "moments"}


@pytest.mark.parametrize(
    "keep", [(), ("meshes",), ("overlaps",), ("overlaps", "meshes", "overlaps")], ids=str
)
def test_what_options_name_is_stored_and_comes_back(keep: tuple[str, ...], tmp_path: Path) -> None:
    with keeping(tmp_path / "c.sqlite", options_keeping(*keep)) as store:
        assert stored_parts(store) == ALWAYS.union(keep)
        for number, shape in enumerate(eggs()):
            again = store.shape(f"egg{number}", NEEDS)
            assert len(again.surfaces) == len(shape.surfaces)
            for one, other in zip(again.surfaces, shape.surfaces, strict=True):
                assert one.mesh == (other.mesh if "meshes" in keep else None)
                assert (one.spectrum == other.spectrum) is bool(keep)
