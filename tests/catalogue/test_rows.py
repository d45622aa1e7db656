"""What the protocol `Rows` asks for, of SQLite files, of PostgreSQL and of the store in CONTRIBUTING.md."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from uuid import uuid4

import numpy as np
import pytest
import shapes
from click.testing import CliRunner
from packages import install, install_contributed

from pcretrieve import Catalogue, PipelineOptions, evaluate, ingest
from pcretrieve.catalogue import STORES, Record, Rows
from pcretrieve.catalogue.rows import OWN, PAYLOADS, Entry, Origin, Payload
from pcretrieve.catalogue.settings import settings_of
from pcretrieve.catalogue.stores import open_rows
from pcretrieve.cli.main import cli
from pcretrieve.errors import CatalogueError, OptionError
from pcretrieve.formats import write_mesh
from pcretrieve.values import UNIT, Step, Verdict

SETTINGS = {"options": "{}", "numbers_version": "7"}
IDS = ("b", "d", "a", "c")
ARRAYS: dict[Payload, bytes] = {"spectra": b"eigenvalues", "meshes": bytes(5000)}


@pytest.fixture(params=["sqlite", "postgresql", "memory"])
def location(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    install_contributed(tmp_path / "site", monkeypatch)
    if request.param == "postgresql":
        return f"{request.getfixturevalue('postgresql')}?schema={uuid4().hex}rows"
    return f"{request.param}://{tmp_path / 'rows'}"


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
def rows(location: str) -> Iterator[Rows]:
    """Four finished shapes, put in another order than that of their ids, and a failed one."""
    with closing(open_rows(location, SETTINGS, create=True)) as store:
        for name in IDS:
            assert store.put(record(name), signature(name), ARRAYS) == record(name)
        store.put(failure("e"), None, {})
        yield store


def ids(records: list[Record]) -> list[str]:
    return [found.id for found in records]


# --- the store ------------------------------------------------------------------------------------------


def test_what_a_store_was_made_with(rows: Rows, location: str) -> None:
    assert SETTINGS.items() <= rows.settings().items()
    assert rows.is_writable
    assert rows.location.endswith("rows")
    with closing(open_rows(location, {"options": "others"}, create=True)) as again:
        assert again.settings() == rows.settings()
        assert again.page(limit=10) == rows.page(limit=10)


def test_a_store_that_is_not_there(location: str) -> None:
    with pytest.raises(CatalogueError, match="there is no catalogue"):
        open_rows(location, SETTINGS, create=False)


def test_numbers_and_areas(rows: Rows) -> None:
    assert (rows.count("done"), rows.count("failed")) == (4, 1)
    rows.put(failure("f"), None, {})
    rows.put(replace(failure("g"), stage="read"), None, {})
    assert rows.failures() == {("clean", "Bad"): 2, ("read", "Bad"): 1}
    assert rows.areas() == {None: (1, 4)}
    for name in ("b", "c"):
        rows.put(record(name, steps=(Step("read", 0.5, {UNIT: 1.0}),)), signature(name), ARRAYS)
    assert rows.areas() == {None: (1, 4), 1.0: (2, 3)}
    rows.remove(["a", "b", "c", "d"])
    assert rows.areas() == {}


# --- records --------------------------------------------------------------------------------------------


def test_pages_ascend(rows: Rows) -> None:
    assert ids(rows.page(limit=10)) == ["a", "b", "c", "d", "e"]
    assert ids(rows.page(after="a", offset=1, limit=2)) == ["c", "d"]
    assert ids(rows.page(limit=10, status="failed")) == ["e"]
    assert ids(rows.page(after="aa", limit=1, status="done")) == ["b"]
    assert rows.page(limit=10)[0] == record("a")
    assert rows.page(limit=10)[-1] == failure("e")


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


def test_a_payload_is_kept_of_a_shape_that_is_still_there(rows: Rows) -> None:
    rows.put(record("a"), b"signature", ARRAYS)
    for arrays in (b"first", b"second"):
        rows.keep_payload("thumbnails", record("a"), arrays)
        assert rows.read("a", ["thumbnails"]) == (record("a"), {"thumbnails": arrays})
    before = rows.revision()
    rows.keep_payload("thumbnails", replace(record("a"), content_hash="other"), b"third")
    rows.keep_payload("thumbnails", record("gone"), b"third")
    assert rows.read("a", PAYLOADS) == (record("a"), {**ARRAYS, "thumbnails": b"second"})
    assert rows.revision() == before, "indexes do not depend on it"


def test_shapes_of_some_classes(rows: Rows) -> None:
    rows.put(record("f", label="other"), signature("f"), {})
    rows.put(record("g", label=None), signature("g"), {})
    rows.put(replace(failure("h"), label="label"), None, {})
    assert rows.labelled(["label"]) == ["a", "b", "c", "d"]
    assert rows.labelled(["other", "label", "nobody"]) == ["a", "b", "c", "d", "f"]
    assert rows.labelled([]) == []


def test_records_by_id_and_by_content(rows: Rows) -> None:
    rows.put(record("f", content_hash="hash-b"), signature("f"), {})
    assert ids(rows.by_id(["d", "nobody", "a", "d"])) == ["a", "d"]
    assert ids(rows.by_content(["hash-b", "hash-a", "none"])) == ["a", "b", "f"]


def test_a_path_keeps_its_id_and_an_id_that_is_taken_gets_a_number(rows: Rows) -> None:
    again = rows.put(record("f", path="/a.ply", content_hash="new"), signature("f"), {})
    assert (again.id, again.content_hash) == ("a", "new")
    other = rows.put(record("a", path="/other/a.ply"), signature("a"), {})
    assert other.id == "a-2"
    assert rows.put(record("a", path="/third/a.ply"), signature("a"), {}).id == "a-3"
    assert ids(rows.page(limit=10)) == ["a", "a-2", "a-3", "b", "c", "d", "e"]


def test_what_a_shape_had_before_is_gone(rows: Rows) -> None:
    rows.keep("other", [(record("a"), b"kept")])
    rows.put(record("a", content_hash="new"), signature("z"), {"spectra": b"others"})
    found = rows.read("a", PAYLOADS)
    assert found == (record("a", content_hash="new"), {"spectra": b"others"})
    assert not rows.signatures("other").has.any()
    assert rows.signatures(OWN).packed[0].tobytes() == signature("z")


def test_a_failure_replaces_a_failure_only(rows: Rows) -> None:
    assert rows.put(failure("a"), None, {}) == record("a")
    assert rows.put(replace(failure("e"), message="again"), None, {}).message == "again"
    assert rows.put(record("e"), signature("e"), ARRAYS) == record("e")
    assert rows.count("failed") == 0


def test_removal(rows: Rows) -> None:
    rows.remove(["a", "nobody", "e"])
    assert ids(rows.page(limit=10)) == ["b", "c", "d"]
    assert rows.read("a", PAYLOADS) is None
    assert rows.signatures(OWN).ids == ["b", "c", "d"]


def test_revision_by_path(rows: Rows) -> None:
    rows.revise(
        moved={"/a.ply": "/new.ply", "/b.ply": "/c.ply", "/nobody": "/somebody"},
        removed=["/d.ply", "/nobody"],
        labels={"/new.ply": "round", "/a.ply": "lost", "/nobody": "lost", "/c.ply": None},
        stamps={"/new.ply": "7 1 2 3", "/d.ply": "lost"},
    )
    found = {one.id: (one.path, one.label, one.stamp) for one in rows.page(limit=10)}
    assert found == {
        "a": ("/new.ply", "round", "7 1 2 3"),
        "b": ("/b.ply", "label", None),
        "c": ("/c.ply", None, None),
        "e": ("/e.ply", None, None),
    }
    assert [(origin.id, origin.stamp) for origin in rows.origins()][:2] == [("a", "7 1 2 3"), ("b", None)]


# --- bytes ----------------------------------------------------------------------------------------------


def test_payloads_that_are_asked_for(rows: Rows) -> None:
    assert rows.read("b", PAYLOADS) == (record("b"), ARRAYS)
    assert rows.read("b", ["meshes", "overlaps"]) == (record("b"), {"meshes": ARRAYS["meshes"]})
    assert rows.read("e", PAYLOADS) == (failure("e"), {})
    assert rows.read("nobody", PAYLOADS) is None


def test_sizes(rows: Rows) -> None:
    rows.keep("other", [(record("b"), b"12345678")])
    sizes = rows.sizes("b")
    assert sizes.pop("record") > len("b/b.plyhash-blabel")
    assert sizes == {
        "signatures": 24,
        "spectra": 11,
        "moments": 0,
        "overlaps": 0,
        "meshes": 5000,
        "thumbnails": 0,
    }
    assert sum(rows.sizes("e").values()) == rows.sizes("e")["record"]


def test_signatures_in_the_order_of_ids(rows: Rows) -> None:
    rows.revise(moved={}, removed=[], labels={"/b.ply": "other"}, stamps={})
    listed = rows.signatures(OWN)
    assert listed.revision == rows.revision()
    assert (listed.ids, listed.labels) == (["a", "b", "c", "d"], ["label", "other", "label", "label"])
    assert [row.tobytes() for row in listed.packed] == [signature(name) for name in "abcd"]
    assert listed.has.all()
    empty = rows.signatures("none")
    assert empty.ids == listed.ids
    assert not empty.has.any()


def test_signatures_are_kept_of_shapes_that_are_still_there(rows: Rows) -> None:
    made = [record("b"), record("c", content_hash="replaced since"), record("x"), record("d")]
    rows.keep("other", [(one, one.id.encode() * 8) for one in made])
    listed = rows.signatures("other")
    assert listed.has.tolist() == [False, True, False, True]
    assert [row.tobytes() for row in listed.packed] == [bytes(8), b"b" * 8, bytes(8), b"d" * 8]
    rows.keep("other", [(record("b"), b"new bits")])
    assert rows.signatures("other").packed[1].tobytes() == b"new bits"


def test_states_have_names(rows: Rows) -> None:
    states = [rows.revision()]
    rows.put(failure("f"), None, {})
    assert rows.revision() == states[0]
    for change in (
        lambda: rows.put(record("f"), signature("f"), {}),
        lambda: rows.put(record("f"), signature("f"), {}),
        lambda: rows.remove(["f"]),
        lambda: rows.revise(moved={}, removed=["/a.ply"], labels={}, stamps={}),
    ):
        change()
        states.append(rows.revision())
    assert len({state.shapes for state in states}) == len(states)
    rows.revise(moved={}, removed=[], labels={"/b.ply": "x"}, stamps={})
    assert rows.revision().labels not in {state.labels for state in states}


# --- entries --------------------------------------------------------------------------------------------


def test_entries_have_all_that_is_stored(rows: Rows) -> None:
    rows.keep("other", [(record("b"), b"12345678")])
    first, second = rows.entries(["e", "b", "nobody", "b"])
    assert (first.record, second.record) == (record("b"), failure("e"))
    assert first.signatures == {OWN: signature("b"), "other": b"12345678"}
    assert (first.payloads, second.signatures, second.payloads) == (ARRAYS, {}, {})


def test_entries_are_stored_as_they_are(rows: Rows) -> None:
    before = rows.revision()
    changed = record("a", content_hash="new", label=None)
    new = [Entry(changed, {"other": b"1"}, {}), Entry(record("f"), {OWN: signature("f")}, ARRAYS)]
    rows.add(new)
    assert rows.revision().shapes != before.shapes
    assert ids(rows.page(limit=10)) == ["a", "b", "c", "d", "e", "f"]
    assert rows.read("a", PAYLOADS) == (changed, {})
    assert rows.signatures(OWN).has.tolist() == [False, True, True, True, True]
    for given, stored in zip(new, rows.entries(["a", "f"]), strict=True):
        assert (given.record, given.signatures) == (stored.record, stored.signatures)
        assert given.payloads == stored.payloads


def test_origins(rows: Rows) -> None:
    assert [origin.id for origin in rows.origins()] == ["a", "b", "c", "d", "e"]
    assert rows.origins()[1] == Origin("b", "/b.ply", "hash-b", "label", "done")
    assert rows.origins()[4] == Origin("e", "/e.ply", "", None, "failed")


def test_times(rows: Rows) -> None:
    expected = {record.id: record.added for record in rows.page(limit=10)}
    assert rows.times() == expected
    assert len(expected) == 5


# --- catalogues -----------------------------------------------------------------------------------------


@pytest.fixture
def eggs(tmp_path: Path) -> list[Path]:
    paths = [tmp_path / f"egg{number}.off" for number in range(4)]
    for number, path in enumerate(paths):
        write_mesh(shapes.ellipsoid((1, 1, 1 + number / 3), subdivisions=3), path)
    return paths


def test_a_catalogue_of_any_store(location: str, eggs: list[Path]) -> None:
    """Ingest, query, evaluate, other descriptors and a page of records are those of an SQLite file."""
    labels = {"egg0": "short", "egg1": "short", "egg2": "long", "egg3": "long"}
    plain = eggs[0].with_name("plain.sqlite")
    for place in (location, plain):
        assert len(ingest(eggs, place, labels=labels, workers=1).done) == 4
        assert len(ingest(eggs, place, workers=1).held) == 4
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


def test_the_command_line_takes_a_url(location: str, eggs: list[Path]) -> None:
    def run(*arguments: object) -> str:
        result = CliRunner().invoke(cli, [str(word) for word in arguments])
        assert result.exit_code == 0, result.output
        return result.stdout

    run("ingest", *eggs, "-c", location, "--workers", "1")
    assert len(run("list", "-c", location).splitlines()) == 1 + 4  # with the names of the columns
    assert "egg1" in run("query", "egg1", "-c", location).splitlines()[1]


def test_what_is_no_store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    points = "[pcretrieve.stores]\nnumber = numbers_package:SEVEN\n"
    install(tmp_path / "site", "numbers-package", {"numbers_package": "SEVEN = 7\n"}, points, monkeypatch)
    assert STORES.names.all() == ("sqlite", "postgresql", "number")
    with pytest.raises(OptionError, match="there is no store 'mysql'; there are sqlite, postgresql, number"):
        Catalogue("mysql://host/shapes", create=True)
    with pytest.raises(OptionError, match=r"'number' .* must be a callable of the protocol OpenStore, got 7"):
        Catalogue("number://7", create=True)
    with pytest.raises(CatalogueError, match="there is no catalogue"):
        Catalogue(Path("sqlite://rows"))


def test_a_catalogue_has_its_location(tmp_path: Path) -> None:
    options = PipelineOptions().changed(signature={"n_values": 9})
    with closing(open_rows(tmp_path / "c.sqlite", settings_of(options), create=True)) as rows:
        assert rows.location == str(tmp_path / "c.sqlite")
    with Catalogue(f"sqlite://{tmp_path / 'c.sqlite'}") as store:
        assert (store.location, store.options) == (str(tmp_path / "c.sqlite"), options)
    np.testing.assert_array_equal(sorted(path.name for path in tmp_path.iterdir()), ["c.sqlite"])
