"""Stored indexes belong to a state of the catalogue, and give the results of newly computed indexes."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import shapes

from pcretrieve import Catalogue, PipelineOptions, SignatureIndex
from pcretrieve.catalogue import Content, Record
from pcretrieve.catalogue import cache as gallery
from pcretrieve.descriptors import describe
from pcretrieve.errors import InputError
from pcretrieve.pipeline.process import process
from pcretrieve.retrieval import DISTANCES, resolution_covariance, table_whitening
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
        other.rows.database._connection.set_trace_callback(statements.append)
        index = other.index(options)
        assert other.whitening(options) == index.whitening
        assert not [text for text in statements if "signatures" in text], "it was computed again"
        assert_same(index, catalogue, options)


def test_neighbours_have_the_changes_of_resolution_as_a_prior(catalogue: Catalogue) -> None:
    """Queries are whitened as evaluations are."""
    options = asked("neighbours")
    table = catalogue.signatures(options)
    expected = table_whitening(table, options.retrieval, prior=resolution_covariance(options.compared))
    assert expected.kind == "neighbours"
    assert expected != table_whitening(table, options.retrieval)
    assert catalogue.whitening(options) == expected
    assert catalogue.index(options).whitening == expected


def test_each_request_has_an_index_of_its_own(catalogue: Catalogue) -> None:
    requests = [asked(w, d) for w in WHITENINGS for d in DISTANCES]
    requests += [
        asked("pca").changed(retrieval={"shrinkage": 0.5}),
        asked().changed(signature={"n_values": 9}),
    ]
    for options in requests:
        catalogue.index(options)
    assert len(kept(catalogue)) == len(requests)


def test_what_others_add_and_remove_is_noticed(catalogue: Catalogue) -> None:
    before = catalogue.index()
    with Catalogue(catalogue.location) as other:
        put(other, N_SHAPES)
        assert list(catalogue.index().ids) == [*before.ids, f"s{N_SHAPES:03}"]
        other.remove("s003")
        assert "s003" not in catalogue.index().ids
    assert_same(catalogue.index(asked()), catalogue, asked())


def test_a_change_of_shapes_makes_all_of_them_anew(catalogue: Catalogue) -> None:
    for whitening in WHITENINGS:
        catalogue.index(asked(whitening))

    def remove() -> None:
        catalogue.remove("s003")

    def replace_content() -> None:
        put(catalogue, 7)
        catalogue.put(
            replace(catalogue.record("s007"), content_hash="other"),
            Content(egg(), describe(egg(), OPTIONS.signature).values),
        )

    for change in (remove, lambda: put(catalogue, N_SHAPES), replace_content):
        stale = kept(catalogue)
        change()
        for whitening in WHITENINGS:
            assert_same(catalogue.index(asked(whitening)), catalogue, asked(whitening))
        assert not set(stale) & set(kept(catalogue))
        assert len(kept(catalogue)) == len(WHITENINGS)


def test_a_change_of_labels_makes_anew_what_depends_on_labels(catalogue: Catalogue) -> None:
    before = [catalogue.index(asked(whitening)) for whitening in WHITENINGS]
    catalogue.revise(labels={"/s001.off": "another"})
    after = [catalogue.index(asked(whitening)) for whitening in WHITENINGS]
    for whitening, old, new in zip(WHITENINGS, before, after, strict=True):
        changed = not np.array_equal(old.whitening.matrix, new.whitening.matrix)
        assert changed == (whitening == "within-class")
        assert_same(new, catalogue, asked(whitening))
    assert len(kept(catalogue)) == len(WHITENINGS)


@pytest.mark.parametrize("change", ["a failure", "another path", "a descriptor that is computed"])
def test_what_moves_no_signature_leaves_them(change: str, catalogue: Catalogue) -> None:
    catalogue.index(asked())
    before = kept(catalogue)
    if change == "a failure":
        catalogue.put(Record("x", "/x.ply", "", status="failed"))
    elif change == "another path":
        catalogue.revise(moved={"/s001.off": "/elsewhere.off"})
    else:
        catalogue.signatures(OPTIONS.changed(signature={"method": "wks"}))
    catalogue.index(asked())
    assert kept(catalogue) == before


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


def test_what_killed_processes_left_is_removed_after_a_while(catalogue: Catalogue) -> None:
    catalogue.index(asked())
    folder = kept(catalogue)[0].parent
    recent, old = folder / f"{gallery.UNFINISHED}recent", folder / f"{gallery.UNFINISHED}old"
    for left in (recent, old):
        left.mkdir()
        (left / "gallery.npy").write_bytes(b"half")
    os.utime(old, (time.time() - 2 * gallery.ABANDONED,) * 2)
    catalogue.index(asked("pca"))
    assert recent.exists()
    assert not old.exists()


def test_where_the_folder_cannot_be_written_the_users_cache_is_taken(
    catalogue: Catalogue, tmp_path: Path
) -> None:
    # Even root cannot make a folder where a file is.
    Path(catalogue.location).with_name("c.sqlite.gallery").touch()
    catalogue.index(asked())
    (cached,) = (tmp_path / "cache" / "pcretrieve").iterdir()
    assert cached.name.startswith("c.sqlite-")
    assert len(list(cached.iterdir())) == 1
    with Catalogue(catalogue.location) as other:
        assert_same(other.index(asked()), catalogue, asked())


def test_without_any_folder_it_answers_all_the_same(catalogue: Catalogue, tmp_path: Path) -> None:
    Path(catalogue.location).with_name("c.sqlite.gallery").touch()
    (tmp_path / "cache").touch()
    assert_same(catalogue.index(asked()), catalogue, asked())


@pytest.mark.slow
def test_several_processes_may_make_one_at_once(catalogue: Catalogue) -> None:
    code = (
        "import sys; from pcretrieve import Catalogue; from pcretrieve.catalogue import cache as gallery; "
        "gallery.SMALLEST_KEPT = 1; print(Catalogue(sys.argv[1]).index().nearest('s005', 3).ids)"
    )
    running = [
        subprocess.Popen([sys.executable, "-c", code, catalogue.location], stdout=subprocess.PIPE, text=True)
        for _ in range(3)
    ]
    expected = f"{fresh(catalogue, OPTIONS).query(catalogue.signatures().values[5], 3).ids}\n"
    assert [process.communicate(timeout=100)[0] for process in running] == [expected] * 3
    assert len(kept(catalogue)) == 1


def test_a_small_catalogue_keeps_none(catalogue: Catalogue, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gallery, "SMALLEST_KEPT", N_SHAPES + 1)
    assert_same(catalogue.index(asked("pca")), catalogue, asked("pca"))
    assert kept(catalogue) == []


def test_an_empty_catalogue_has_no_index(tmp_path: Path) -> None:
    with (
        Catalogue(tmp_path / "empty.sqlite", create=True) as store,
        pytest.raises(InputError, match="ingest shapes first"),
    ):
        store.index()
