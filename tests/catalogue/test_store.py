"""The catalogue gives back what was put in, to readers and writers at once."""

from __future__ import annotations

import os
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
from pcretrieve.catalogue import Content, Record, opening
from pcretrieve.descriptors import describe
from pcretrieve.errors import CatalogueError, InputError, ShapeError, SpectrumError
from pcretrieve.options import SignatureOptions
from pcretrieve.pipeline.process import process
from pcretrieve.retrieval import SignatureIndex, fit_whitening, log_signatures
from pcretrieve.values import Shape

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


def test_a_shape_takes_the_place_of_the_one_with_its_path(catalogue: Catalogue) -> None:
    stored = catalogue.put(Record("new", "/eggs/egg0.off", "newhash"), content(5))
    assert len(catalogue) == N_SHAPES
    assert (stored.id, stored.content_hash) == ("egg0", "newhash")
    assert catalogue.record("egg0") == stored
    np.testing.assert_array_equal(catalogue.mesh("egg0").vertices, content(5).shape.mesh.vertices)


def test_an_id_that_another_path_has_gets_the_next_number(catalogue: Catalogue) -> None:
    before = catalogue.record("egg0")
    stored = [catalogue.put(Record("egg0", f"/nest{n}/egg0.off", "newhash"), content(5)) for n in range(20)]
    assert [record.id for record in stored] == [f"egg0-{number}" for number in range(2, 22)]
    assert len(catalogue) == N_SHAPES + 20
    assert catalogue.record("egg0") == before


def test_a_failure_takes_no_finished_shapes_place(catalogue: Catalogue) -> None:
    before = catalogue.record("egg0")
    stored = catalogue.put(Record("egg0", "/eggs/egg0.off", "", status="failed", message="away"))
    assert stored == before == catalogue.record("egg0")
    np.testing.assert_array_equal(catalogue.mesh("egg0").vertices, content(0).shape.mesh.vertices)


def test_a_failed_shape_is_known_but_has_nothing_to_give(catalogue: Catalogue) -> None:
    why = {"status": "failed", "stage": "clean", "error": "ReconstructionError", "message": "all equal"}
    catalogue.put(Record("bad", "/eggs/bad.ply", "x", "round", **why))  # type: ignore[arg-type]
    assert catalogue.record("bad").message == "all equal"
    assert len(catalogue) == N_SHAPES
    assert "bad" not in catalogue.signatures().ids
    with pytest.raises(InputError, match="'bad' has no surface: it failed in clean: all equal"):
        catalogue.mesh("bad")


def test_labels_moves_and_removals(catalogue: Catalogue) -> None:
    catalogue.revise(
        moved={
            "/eggs/egg1.off": "/nest/egg1.off",
            "/eggs/egg3.off": "/eggs/egg4.off",
            "/nobody": "/somebody",
        },
        removed=["/eggs/egg5.off", "/nobody"],
        labels={"/eggs/egg0.off": "odd", "/nest/egg1.off": "moved", "/nobody": "odd"},
    )
    catalogue.remove("egg2")
    assert catalogue.record("egg0").label == "odd"
    assert (catalogue.record("egg1").path, catalogue.record("egg1").label) == ("/nest/egg1.off", "moved")
    assert catalogue.record("egg3").path == "/eggs/egg3.off"  # a path that is taken is left alone
    assert catalogue.signatures().ids == ("egg0", "egg1", "egg3", "egg4")
    for gone in ("egg2", "nobody"):
        with pytest.raises(InputError, match=f"holds no shape '{gone}'; `pcretrieve list` names them"):
            catalogue.remove(gone)


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


def test_whitenings_damped_in_two_ways_are_two(catalogue: Catalogue) -> None:
    damped = [OPTIONS.changed(retrieval={"whitening": "pca", "shrinkage": d}) for d in ("auto", 0.01, 0.5)]
    found = [catalogue.whitening(options) for options in (*damped, *damped)]
    assert [whitening.shrinkage for whitening in found] == [0.01, 0.01, 0.5] * 2
    np.testing.assert_array_equal(found[0].matrix, found[1].matrix)
    assert not np.array_equal(found[1].matrix, found[2].matrix)
    np.testing.assert_array_equal(found[2].matrix, found[5].matrix)


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


def test_a_whitening_by_class_follows_the_labels(catalogue: Catalogue) -> None:
    before = catalogue.whitening(whitened("within-class")).matrix
    catalogue.revise(labels={"/eggs/egg2.off": "long"})
    assert not np.array_equal(catalogue.whitening(whitened("within-class")).matrix, before)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write every file")
def test_a_catalogue_that_may_not_be_written_can_be_read(in_file: Catalogue) -> None:
    in_file.close()
    Path(in_file.location).parent.chmod(0o500)
    try:
        with Catalogue(in_file.location) as reader:
            assert len(reader) == N_SHAPES
            assert reader.whitening(whitened("pca")).kind == "pca"
            with pytest.raises(CatalogueError, match="cannot be written to"):
                reader.remove("egg0")
        with pytest.raises(CatalogueError, match="cannot be written to"):
            Catalogue(in_file.location, create=True)
    finally:
        Path(in_file.location).parent.chmod(0o700)


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
    monkeypatch.setattr(opening, "LOCK_TIMEOUT", 0.05)
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
        other.execute("UPDATE thumbnails SET arrays = substr(arrays, 1, 9)")
    with pytest.raises(CatalogueError, match="the thumbnail of 'egg2'"):
        in_file.thumbnail("egg2")
    (found,) = (defect for defect in in_file.defects() if "thumbnail" in defect.message)
    assert found.shape_id == "egg2"
    assert "its thumbnail cannot be read: its checksum does not fit" in found.message


def test_of_a_shape_only_what_is_needed_is_read(in_file: Catalogue) -> None:
    with closing(sqlite3.connect(in_file.location)) as other, other:
        for table, shape_id in (("moments", "egg1"), ("meshes", "egg2")):
            other.execute(
                f"UPDATE {table} SET arrays = x'00' WHERE shape = (SELECT number FROM shapes WHERE id = ?)",
                (shape_id,),
            )
    assert in_file.shape("egg1", needs=("mesh",)).mesh.area == egg(1).area
    assert in_file.shape("egg2", needs=("spectrum",)).spectrum.area == 1
    for part in ("spectrum", "mesh", "points"):
        with pytest.raises(
            ShapeError, match=rf"\[signature\] gone: the shape must hold its {part}, but does not"
        ):
            getattr(in_file.shape("egg0", needs=()), part)
