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
from pcretrieve.catalogue import Content, Record, find_defects, sqlite
from pcretrieve.descriptors import describe
from pcretrieve.errors import CatalogueError, InputError, ShapeError, SpectrumError
from pcretrieve.options import SignatureOptions
from pcretrieve.pipeline.process import process
from pcretrieve.retrieval import SignatureIndex, fit_whitening, log_signatures
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


def test_what_is_put_in_comes_back(catalogue: Catalogue) -> None:
    stored, given = catalogue.record("egg2"), content(2)
    assert (stored.path, stored.content_hash, stored.label) == ("/eggs/egg2.off", "hash2", "round")
    assert (stored.status, stored.options_digest) == ("done", OPTIONS.digest)
    assert stored.steps == given.shape.provenance
    assert (stored.n_vertices, stored.n_faces, stored.euler) == (642, 1280, 2)
    assert stored.area == given.shape.area
    assert catalogue.shape("egg2", ("spectrum", "overlaps", "mesh")) == given.shape
    np.testing.assert_array_equal(catalogue.signatures().values[2], given.signature)


def test_everything_outlives_the_process_in_one_file(in_file: Catalogue) -> None:
    before = in_file.records()
    in_file.close()
    assert [str(path) for path in Path(in_file.location).parent.iterdir()] == [in_file.location]
    with Catalogue(in_file.location) as again:
        assert again.records() == before
        assert len(again) == N_SHAPES


def test_a_failed_shape_is_known_but_has_nothing_to_give(catalogue: Catalogue) -> None:
    why = {"status": "failed", "stage": "clean", "error": "ReconstructionError", "message": "all equal"}
    catalogue.put(Record("bad", "/eggs/bad.ply", "x", "round", **why))  # type: ignore[arg-type]
    assert catalogue.record("bad").message == "all equal"
    assert len(catalogue) == N_SHAPES
    assert "bad" not in catalogue.signatures().ids
    with pytest.raises(InputError, match="'bad' has no surface: it failed in clean: all equal"):
        catalogue.mesh("bad")


def test_the_space_of_removed_shapes_is_given_back(in_file: Catalogue) -> None:
    in_file.close()
    path = Path(in_file.location)
    before = path.stat().st_size
    with Catalogue(path) as store:
        left = store.mesh("egg0")
        store.remove(*(f"egg{number}" for number in range(1, N_SHAPES)))
    assert path.stat().st_size < before / 2
    with Catalogue(path) as store:
        assert store.mesh("egg0") == left
        assert store.signatures().ids == ("egg0",)


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


def test_a_shape_that_has_no_such_signature_is_named(catalogue: Catalogue) -> None:
    few = process(shapes.ellipsoid(subdivisions=1), OPTIONS.changed(spectral={"n_pairs": 21}))
    values = describe(egg(1), OPTIONS.signature).values
    catalogue.put(record(1), Content(few, values))
    with pytest.raises(SpectrumError, match=r"\[egg1 / spectrum\] 61 eigenpairs need a surface of at least"):
        catalogue.signatures(OPTIONS.changed(signature={"method": "hks-bow"}))


# --- whitening ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["pca", "within-class"])
def test_a_whitening_is_fitted_anew_once_the_shapes_change(kind: str, catalogue: Catalogue) -> None:
    def fitted() -> bytes:
        """Also by other processes: the catalogue always gives the results of its present shapes."""
        table = catalogue.signatures(whitened(kind))
        expected = fit_whitening(
            kind, log_signatures(table.values), table.labels, options_digest=table.digest
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


def test_options_of_other_spectra_are_refused(catalogue: Catalogue) -> None:
    other = OPTIONS.changed(spectral={"n_pairs": 91}, retrieval={"whitening": "pca"})
    for ask in (catalogue.signatures, catalogue.whitening):
        with pytest.raises(CatalogueError, match=r"spectral.n_pairs: 61 there, 91 here. Only the options in"):
            ask(other)


def test_signatures_and_whitening_agree_about_the_scale(catalogue: Catalogue) -> None:
    """PCA whitening is of relative values where no scale was named, in both of them."""
    for scale, expected in (("auto", "relative"), ("area", "area"), ("relative", "relative")):
        options = OPTIONS.changed(signature={"scale": scale}, retrieval={"whitening": "pca"})
        table, whitening = catalogue.signatures(options), catalogue.whitening(options)
        assert whitening.options_digest == table.digest == options.compared_digest
        named = OPTIONS.changed(signature={"scale": expected})
        np.testing.assert_array_equal(table.values, catalogue.signatures(named).values)
        assert table.digest == named.signature_digest


def test_the_whitening_by_resolution_is_not_fitted(catalogue: Catalogue) -> None:
    options = whitened("resolution").changed(signature={"method": "r-bihdm"})
    table = catalogue.signatures(options)
    whitening = catalogue.whitening(options)
    assert whitening.options_digest == table.digest
    catalogue.remove("egg5")
    np.testing.assert_array_equal(catalogue.whitening(options).matrix, whitening.matrix)
    left = catalogue.signatures(options)
    assert len(SignatureIndex(left, whitening=whitening).query(table.values[0], 3).ids) == 3


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


@cache
def nest() -> Shape:
    """A scan that was made into three surfaces."""
    return Shape(tuple(egg(number).surfaces[0] for number in (2, 3, 4)), provenance=egg(2).provenance)


@pytest.mark.parametrize("method", ["r-bihdm", "sd-gdm", "hks-bow"])
def test_every_surface_of_a_scan_is_kept(method: str, catalogue: Catalogue) -> None:
    if method == "sd-gdm":
        pytest.importorskip("potpourri3d", reason="geodesic distances come from potpourri3d")
    options = SignatureOptions(method=method)
    signature = describe(nest(), options)
    catalogue.put(record(2), Content(nest(), signature.values))
    stored = catalogue.shape("egg2", ("spectrum", "overlaps", "mesh"))
    assert stored == nest()
    again = describe(stored, options)
    np.testing.assert_array_equal(again.values, signature.values)
    np.testing.assert_array_equal(again.deviation, signature.deviation)


def test_a_picture_comes_back_to_the_byte(catalogue: Catalogue) -> None:
    picture = bytes(range(256)) * 30
    catalogue.put(record(2), replace(content(2), thumbnail=picture))
    assert catalogue.thumbnail("egg2") == picture
    assert catalogue.thumbnail("egg1") is None
    catalogue.put(record(2), content(2))
    assert catalogue.thumbnail("egg2") is None
    with pytest.raises(InputError, match="holds no shape 'egg9'"):
        catalogue.thumbnail("egg9")


def test_a_damaged_picture_is_noticed(in_file: Catalogue) -> None:
    in_file.put(record(2), replace(content(2), thumbnail=bytes(5000)))
    with closing(sqlite3.connect(in_file.location)) as other, other:
        other.execute("UPDATE arrays SET thumbnails = substr(thumbnails, 1, 9)")
    with pytest.raises(CatalogueError, match="the thumbnail of 'egg2'"):
        in_file.thumbnail("egg2")
    (found,) = (defect for defect in find_defects(in_file) if "thumbnail" in defect.message)
    assert found.shape_id == "egg2"
    assert "its thumbnail cannot be read: its checksum does not fit" in found.message


def test_of_a_shape_only_what_is_needed_is_read(in_file: Catalogue) -> None:
    with closing(sqlite3.connect(in_file.location)) as other, other:
        for table, shape_id in (("moments", "egg1"), ("meshes", "egg2")):
            other.execute(
                f"UPDATE arrays SET {table} = x'00' WHERE shape = (SELECT number FROM shapes WHERE id = ?)",
                (shape_id,),
            )
    assert in_file.shape("egg1", needs=("mesh",)).mesh.area == egg(1).area
    assert in_file.shape("egg2", needs=("spectrum",)).spectrum.area == 1
    for part in ("spectrum", "mesh", "points"):
        with pytest.raises(
            ShapeError, match=rf"\[signature\] gone: the shape must hold its {part}, but does not"
        ):
            getattr(in_file.shape("egg0", needs=()), part)


# --- parts that options name ----------------------------------------------------------------------------

NEEDS: tuple[Need, ...] = ("spectrum", "overlaps", "mesh")
OVERLAP_METHODS = ("wks", "bihdm")


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


@pytest.mark.parametrize("method", OVERLAP_METHODS)
def test_overlaps_are_computed_from_meshes_to_the_same_bits(method: str, tmp_path: Path) -> None:
    options = PipelineOptions().changed(signature={"method": method})
    with keeping(tmp_path / "c.sqlite", PipelineOptions()) as store:
        values = store.signatures(options).values
        assert store.shape("egg0", ("spectrum", "overlaps")).surfaces[0].mesh is None
        assert store.shape("egg0").spectrum.overlaps is None
    for row, shape in zip(values, eggs(), strict=True):
        np.testing.assert_array_equal(row, describe(shape, options.signature).values)


def test_a_spectrum_of_points_keeps_its_overlaps(tmp_path: Path) -> None:
    """The star of triangles about each point is no surface that the spectrum could be computed from again."""
    options = PipelineOptions().changed(spectral={"element": "points"})
    with keeping(tmp_path / "c.sqlite", options) as store:
        assert "overlaps" in stored_parts(store)
        egg = eggs("points")[0]
        assert store.shape("egg0", NEEDS) == Shape(egg.surfaces, verdict=egg.verdict)


@pytest.mark.parametrize(("method", "part"), [("wks", "overlaps"), ("hks-bow", "mesh")])
def test_what_is_neither_stored_nor_computed_is_gone(method: str, part: str, tmp_path: Path) -> None:
    with keeping(tmp_path / "c.sqlite", options_keeping()) as store:
        options = store.options.changed(signature={"method": method})
        with pytest.raises(ShapeError, match=rf"\[egg0 / signature\] gone: .* {part}"):
            store.signatures(options)
        assert len(store.signatures(store.options.changed(signature={"method": "shape-dna"}))) == 3
        with pytest.raises(ShapeError, match=r"\[egg1 / signature\] gone: the shape must hold its mesh"):
            store.mesh("egg1")


def test_one_catalogue_keeps_the_same_of_all_shapes(tmp_path: Path) -> None:
    keeping(tmp_path / "c.sqlite", options_keeping("overlaps", "meshes")).close()
    Catalogue(tmp_path / "c.sqlite", options_keeping("meshes", "overlaps")).close()
    with pytest.raises(
        CatalogueError, match=r"catalogue.keep: \('meshes', 'overlaps'\) there, \('meshes',\) here"
    ):
        Catalogue(tmp_path / "c.sqlite", PipelineOptions())
