"""What is stored comes back, by the same statements from an SQLite file and from a PostgreSQL database."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
import shapes
from processes import in_this_process

from pcretrieve import Catalogue, PipelineOptions, evaluate, ingest
from pcretrieve.catalogue.records import OWN, Entry, Origin, Record
from pcretrieve.catalogue.rows import Rows
from pcretrieve.catalogue.settings import settings_of
from pcretrieve.catalogue.tables import PAYLOADS, Payload
from pcretrieve.errors import CatalogueError, OptionError
from pcretrieve.formats import write_mesh
from pcretrieve.values import UNIT, Step, Verdict

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


def signature(name: str) -> bytes:
    return name.encode() * 16


@pytest.fixture
def rows(new_location: str) -> Iterator[Rows]:
    """Four finished shapes, put in another order than that of their ids, and a failed one."""
    with closing(Rows(new_location, SETTINGS, create=True)) as store:
        for name in IDS:
            assert store.put(record(name), signature(name), ARRAYS) == record(name)
        store.put(failure("e"), None, {})
        yield store


def ids(records: list[Record]) -> list[str]:
    return [found.id for found in records]


def test_records_are_found(rows: Rows, new_location: str) -> None:
    assert SETTINGS.items() <= rows.settings().items()
    assert rows.database.is_writable
    with closing(Rows(new_location, {"options": "others"}, create=True)) as again:
        assert again.settings() == rows.settings()
        assert again.page(limit=10) == rows.page(limit=10)
    assert rows.page(limit=10) == [record("a"), record("b"), record("c"), record("d"), failure("e")]
    assert ids(rows.page(after="a", offset=1, limit=2)) == ["c", "d"]
    assert ids(rows.page(limit=10, status="failed")) == ["e"]
    assert ids(rows.page(after="aa", limit=1, status="done")) == ["b"]
    assert rows.origins()[1] == Origin("b", "/b.ply", "hash-b", "label", "done")
    assert rows.origins()[4] == Origin("e", "/e.ply", "", None, "failed")
    assert rows.times() == {found.id: found.added for found in rows.page(limit=10)}
    rows.put(record("f", content_hash="hash-b"), signature("f"), {})
    assert ids(rows.by("id", ["d", "nobody", "a", "d"])) == ["a", "d"]
    assert ids(rows.by("content_hash", ["hash-b", "hash-a", "none"])) == ["a", "b", "f"]
    rows.put(record("g", label=None), signature("g"), {})
    rows.put(record("h", label="other"), signature("h"), {})
    rows.put(replace(failure("i"), label="label"), None, {})
    assert rows.labelled(["other", "label", "nobody"]) == ["a", "b", "c", "d", "f", "h"]
    assert rows.labelled([]) == []


def test_numbers_and_areas(rows: Rows) -> None:
    assert (rows.count("done"), rows.count("failed")) == (4, 1)
    rows.put(failure("f"), None, {})
    rows.put(replace(failure("g"), stage="read"), None, {})
    assert rows.failures() == {("clean", "Bad"): 2, ("read", "Bad"): 1}
    for name in ("b", "c"):
        rows.put(record(name, steps=(Step("read", 0.5, {UNIT: 1.0}),)), signature(name), ARRAYS)
    assert rows.areas() == {None: (1, 4), 1.0: (2, 3)}
    rows.remove(["a", "b", "c", "d"])
    assert rows.areas() == {}


def test_doubtful_shapes(rows: Rows) -> None:
    for name, verdict in (
        ("a", Verdict("sound", 0.1)),
        ("b", Verdict("doubtful", 0.4, ("gaps: wide", "noise: much"))),
        ("d", Verdict("unusable", 2.0, ("gaps: wide",))),
    ):
        judged = record(name, verdict=verdict)
        assert rows.put(judged, signature(name), {}) == judged
    assert ids(rows.page(limit=10, doubtful=True)) == ["b", "d"]
    assert ids(rows.page(after="b", limit=10, status="done", doubtful=True)) == ["d"]


def test_a_path_keeps_its_id_and_an_id_that_is_taken_gets_a_number(rows: Rows) -> None:
    again = rows.put(record("f", path="/a.ply", content_hash="new"), signature("f"), {})
    assert (again.id, again.content_hash) == ("a", "new")
    others = [rows.put(record("a", path=f"/{place}/a.ply"), signature("a"), {}).id for place in range(20)]
    assert others == [f"a-{number}" for number in range(2, 22)]
    assert rows.put(failure("b"), None, {}) == record("b"), "a failure replaces a failure only"
    assert rows.put(replace(failure("e"), message="again"), None, {}).message == "again"
    assert rows.put(record("e"), signature("e"), ARRAYS) == record("e")


def test_what_a_shape_had_before_is_gone(rows: Rows) -> None:
    rows.keep("other", [(record("a"), b"kept"), (record("b"), b"kept")])
    rows.put(record("a", content_hash="new"), signature("z"), {"spectra": b"others"})
    assert rows.read("a", PAYLOADS) == (record("a", content_hash="new"), {"spectra": b"others"})
    rows.remove(["b", "nobody", "e"])
    assert ids(rows.page(limit=10)) == ["a", "c", "d"]
    assert rows.read("b", PAYLOADS) is None
    assert not rows.signatures("other").has.any()
    assert rows.signatures(OWN).ids == ["a", "c", "d"]
    assert rows.signatures(OWN).packed[0].tobytes() == signature("z")


def test_revision_by_path(rows: Rows) -> None:
    rows.revise(
        moved={"/a.ply": "/new.ply", "/b.ply": "/c.ply", "/nobody": "/somebody"},
        removed=["/d.ply", "/nobody"],
        labels={"/new.ply": "round", "/a.ply": "lost", "/nobody": "lost", "/c.ply": "third"},
        stamps={"/new.ply": "7 1 2 3", "/d.ply": "lost"},
    )
    assert {one.id: (one.path, one.label, one.stamp) for one in rows.page(limit=10)} == {
        "a": ("/new.ply", "round", "7 1 2 3"),
        "b": ("/b.ply", "label", None),  # a path that is taken is left alone
        "c": ("/c.ply", "third", None),
        "e": ("/e.ply", None, None),
    }
    assert [(origin.id, origin.stamp) for origin in rows.origins()][:2] == [("a", "7 1 2 3"), ("b", None)]


def test_arrays_and_sizes(rows: Rows) -> None:
    assert rows.read("b", PAYLOADS) == (record("b"), ARRAYS)
    assert rows.read("b", ["meshes", "overlaps"]) == (record("b"), {"meshes": ARRAYS["meshes"]})
    assert rows.read("e", PAYLOADS) == (failure("e"), {})
    assert rows.read("nobody", PAYLOADS) is None
    before = rows.revision()
    for arrays in (b"first", b"second"):
        rows.keep_payload("thumbnails", record("a"), arrays)
    rows.keep_payload("thumbnails", replace(record("a"), content_hash="other"), b"third")
    rows.keep_payload("thumbnails", record("gone"), b"third")
    assert rows.read("a", PAYLOADS) == (record("a"), {**ARRAYS, "thumbnails": b"second"})
    assert rows.revision() == before, "indexes do not depend on it"
    rows.keep("other", [(record("b"), b"12345678")])
    sizes = rows.sizes("b")
    assert sizes.pop("record") > len("b/b.plyhash-blabel")
    lengths = {"signatures": 24, "spectra": 11, "moments": 0, "overlaps": 0, "meshes": 5000, "thumbnails": 0}
    assert sizes == lengths
    assert sum(rows.sizes("e").values()) == rows.sizes("e")["record"]


def test_signatures_are_in_the_order_of_ids(rows: Rows) -> None:
    rows.revise(labels={"/b.ply": "other"})
    listed = rows.signatures(OWN)
    assert listed.revision == rows.revision()
    assert (listed.ids, listed.labels) == (["a", "b", "c", "d"], ["label", "other", "label", "label"])
    assert [row.tobytes() for row in listed.packed] == [signature(name) for name in "abcd"]
    assert listed.has.all()
    assert not rows.signatures("none").has.any()
    # Only of shapes that are still there.
    made = [record("b"), record("c", content_hash="replaced since"), record("x"), record("d")]
    rows.keep("other", [(one, one.id.encode() * 8) for one in made])
    rows.keep("other", [(record("b"), b"new bits")])
    listed = rows.signatures("other")
    assert listed.has.tolist() == [False, True, False, True]
    assert [row.tobytes() for row in listed.packed] == [bytes(8), b"new bits", bytes(8), b"d" * 8]


def test_states_have_names(rows: Rows) -> None:
    states = [rows.revision()]
    rows.put(failure("f"), None, {})
    assert rows.revision() == states[0]
    for change in (
        lambda: rows.put(record("f"), signature("f"), {}),
        lambda: rows.put(record("f"), signature("f"), {}),
        lambda: rows.remove(["f"]),
        lambda: rows.revise(removed=["/a.ply"]),
    ):
        change()
        states.append(rows.revision())
    assert len({state.shapes for state in states}) == len(states)
    rows.revise(labels={"/b.ply": "x"})
    assert rows.revision().labels not in {state.labels for state in states}


def test_entries_are_read_and_stored_as_they_are(rows: Rows) -> None:
    rows.keep("other", [(record("b"), b"12345678")])
    first, second = rows.entries(["e", "b", "nobody", "b"])
    assert (first.record, second.record) == (record("b"), failure("e"))
    assert first.signatures == {OWN: signature("b"), "other": b"12345678"}
    assert (first.payloads, second.signatures, second.payloads) == (ARRAYS, {}, {})
    before = rows.revision()
    changed = record("a", content_hash="new", label=None)
    new = [Entry(changed, {"other": b"1"}, {}), Entry(record("f"), {OWN: signature("f")}, ARRAYS)]
    rows.add(new)
    assert rows.revision().shapes != before.shapes
    assert ids(rows.page(limit=10)) == ["a", "b", "c", "d", "e", "f"]
    assert rows.signatures(OWN).has.tolist() == [False, True, True, True, True]
    for given, stored in zip(new, rows.entries(["a", "f"]), strict=True):
        assert (given.record, given.signatures) == (stored.record, stored.signatures)
        assert given.payloads == stored.payloads


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
    with closing(Rows(tmp_path / "c.sqlite", settings_of(options), create=True)) as rows:
        assert rows.location == str(tmp_path / "c.sqlite")
    with Catalogue(f"sqlite://{tmp_path / 'c.sqlite'}") as store:
        assert (store.location, store.options) == (str(tmp_path / "c.sqlite"), options)
    assert [path.name for path in tmp_path.iterdir()] == ["c.sqlite"]
    with pytest.raises(OptionError, match=r"must be a file, or a database at postgresql://.* got mysql://"):
        Catalogue("mysql://host/shapes", create=True)
    with pytest.raises(CatalogueError, match="there is no catalogue"):
        Catalogue(Path("sqlite://rows"))
