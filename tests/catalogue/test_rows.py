"""What is stored comes back, by the same statements from an SQLite file and from a PostgreSQL database."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import shapes
from processes import in_this_process

from pcretrieve import Catalogue, PipelineOptions, evaluate, ingest
from pcretrieve.catalogue.records import OWN, Entry, Origin, Record, settings_of
from pcretrieve.catalogue.rows import Rows
from pcretrieve.catalogue.tables import Payload
from pcretrieve.errors import CatalogueError, OptionError
from pcretrieve.formats import write_mesh
from pcretrieve.values import Step

SETTINGS = {"options": "{}", "numbers_version": "7"}
IDS = ("b", "d", "a", "c")
ARRAYS: dict[Payload, bytes] = {"spectra": b"eigenvalues", "meshes": bytes(5000)}


def record(name: str, **changes: object) -> Record:
    steps = (Step("read", 0.5, {"points": 7}, ("a note",)),)
    area = float(ord(name[0]) - ord("a") + 1)
    whole = Record(name, f"/{name}.ply", f"hash-{name}", "label", steps=steps, area=area, n_faces=4, euler=2)
    return replace(whole, **changes)  # type: ignore[arg-type]


def failure(name: str) -> Record:
    return Record(name, f"/{name}.ply", "", status="failed", stage="clean", error="Bad", message="why")


def done(name: str, signed: str | None = None, **changes: object) -> Entry:
    return Entry(record(name, **changes), {OWN: (signed or name).encode() * 16}, ARRAYS)


def failed(name: str, **changes: object) -> Entry:
    return Entry(replace(failure(name), **changes), {}, {})  # type: ignore[arg-type]


@pytest.fixture
def rows(new_location: str) -> Iterator[Rows]:
    """Four finished shapes, put in another order than that of their ids, and a failed one."""
    with Rows(new_location, SETTINGS, create=True) as store:
        for name in IDS:
            assert store.store(done(name)) == record(name)
        store.store(failed("e"))
        yield store


def ids(records: list[Record]) -> list[str]:
    return [found.id for found in records]


def test_records_are_found(rows: Rows, new_location: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert SETTINGS.items() <= rows.settings().items()
    assert rows.database.is_writable
    with Rows(new_location, {"options": "others"}, create=True) as again:
        assert again.settings() == rows.settings()
        assert again.records() == rows.records()
    assert rows.records() == [record("a"), record("b"), record("c"), record("d"), failure("e")]
    monkeypatch.setattr("pcretrieve.catalogue.rows.PAGE", 2)
    assert [ids(page) for page in rows.pages(offset=1, limit=3)] == [["b", "c"], ["d"]]
    assert [ids(page) for page in rows.pages(status="done")] == [["a", "b"], ["c", "d"]]
    assert ids(rows.records(status="failed")) == ["e"]
    assert rows.origins()[1] == Origin("b", "/b.ply", "hash-b", "label", "done")
    assert rows.origins()[4] == Origin("e", "/e.ply", "", None, "failed")
    assert rows.times() == {found.id: found.added for found in rows.records()}
    rows.store(done("f", content_hash="hash-b"))
    assert ids(rows.several(["d", "nobody", "a", "d"])) == ["a", "d"]
    assert ids(rows.with_content("hash-b")) == ["b", "f"]
    rows.store(done("g", label=None))
    rows.store(done("h", label="other"))
    rows.store(failed("i", label="label"))
    assert rows.labelled(["other", "label", "nobody"]) == ["a", "b", "c", "d", "f", "h"]
    assert rows.labelled([]) == []


def test_a_path_keeps_its_id_and_an_id_that_is_taken_gets_a_number(rows: Rows) -> None:
    again = rows.store(done("f", path="/a.ply", content_hash="new"))
    assert (again.id, again.content_hash) == ("a", "new")
    others = [rows.store(done("a", path=f"/{place}/a.ply")).id for place in range(20)]
    assert others == [f"a-{number}" for number in range(2, 22)]
    assert rows.store(failed("b")) == record("b"), "a failure replaces a failure only"
    assert rows.store(failed("e", message="again")).message == "again"
    assert rows.store(done("e")) == record("e")


@pytest.mark.slow
def test_a_catalogue_in_a_database_answers_as_a_file(postgresql: str, tmp_path: Path) -> None:
    """Ingest, query, evaluate and other descriptors."""
    eggs = [tmp_path / f"egg{number}.off" for number in range(4)]
    for number, path in enumerate(eggs):
        write_mesh(shapes.ellipsoid((1, 1, 1 + number / 3), subdivisions=3), path)
    labels = {"egg0": "short", "egg1": "short", "egg2": "long", "egg3": "long"}
    location, plain = f"{postgresql}?schema=eggs", tmp_path / "plain.sqlite"
    for place in (location, plain):
        assert len(ingest(eggs, place, labels=labels, executor=in_this_process).done) == 4
        assert len(ingest(eggs, place, executor=in_this_process).held) == 4
    with Catalogue(location) as store, Catalogue(plain) as expected:
        assert [replace(one, steps=(), added="", stamp=None) for one in store.records()] == [
            replace(one, steps=(), added="", stamp=None) for one in expected.records()
        ]
        other = store.options.changed(signature={"method": "wks"}, retrieval={"whitening": "within-class"})
        for options in (None, other, other):
            assert store.signatures(options) == expected.signatures(options)
            assert store.index(options).nearest("egg2") == expected.index(options).nearest("egg2")
        assert store.shape("egg1") == expected.shape("egg1")
    assert evaluate(location) == evaluate(plain)


def test_locations(tmp_path: Path) -> None:
    options = PipelineOptions().changed(signature={"n_values": 9})
    with Rows(tmp_path / "c.sqlite", settings_of(options), create=True) as rows:
        assert rows.location == str(tmp_path / "c.sqlite")
    with Catalogue(f"sqlite://{tmp_path / 'c.sqlite'}") as store:
        assert (store.location, store.options) == (str(tmp_path / "c.sqlite"), options)
    assert [path.name for path in tmp_path.iterdir()] == ["c.sqlite"]
    with pytest.raises(OptionError, match=r"must be a file, or a database at postgresql://.* got mysql://"):
        Catalogue("mysql://host/shapes", create=True)
    with pytest.raises(CatalogueError, match="there is no catalogue"):
        Catalogue(Path("sqlite://rows"))
