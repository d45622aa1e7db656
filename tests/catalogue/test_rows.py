"""What is stored comes back, from a file as from a database of several users; merges of catalogues."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import pytest
from commands import run
from stored import content, failure, records

import pcretrieve as pr
from pcretrieve import Catalogue, PipelineOptions, merge_catalogues
from pcretrieve.catalogue import Record, postgresql as postgresql_module
from pcretrieve.catalogue.records import OWN, PAYLOADS, Entry, settings_of
from pcretrieve.catalogue.rows import Rows
from pcretrieve.errors import CatalogueError, InputError, OptionError
from pcretrieve.values import Grade, Step

SETTINGS = {"options": "{}", "numbers_version": "7"}
IDS = ("b", "d", "a", "c")
DAYS = (None, ("2026-01-02", "2026-01-02"), ("", "2026-01-01"))


def done(name: str, **changes: Any) -> Entry:
    steps = (Step("read", 0.5, {"points": 7}, ("a note",)),)
    area = float(ord(name[0]) - ord("a") + 1)
    record = Record(
        name,
        f"/{name}.ply",
        f"hash-{name}",
        "label",
        steps=steps,
        area=area,
        n_faces=4,
        euler=2,
    )
    bits = name[:1].encode() * 8
    payloads = {payload: bits * number for number, payload in enumerate(PAYLOADS, 1)}
    return Entry(replace(record, **changes), {OWN: bits, "other": bits * 2}, payloads)


def failed(name: str, **changes: Any) -> Entry:
    return Entry(failure(name, **({"stage": "clean"} | changes)), {}, {})


@pytest.fixture
def rows(new_location: str) -> Iterator[Rows]:
    """Four finished shapes, put in another order than that of their ids, and a failed one."""
    with Rows(new_location, SETTINGS, create=True) as store:
        for name in IDS:
            assert store.store(done(name)) == done(name).record
        store.store(failed("e"))
        yield store


def ids(records: list[Record]) -> list[str]:
    return [found.id for found in records]


def test_records_are_found(
    rows: Rows, new_location: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert SETTINGS.items() <= rows.settings().items()
    assert rows.database.is_writable
    with Rows(new_location, {"options": "others"}, create=True) as again:
        assert again.settings() == rows.settings()
        assert records(again) == records(rows)
    assert records(rows) == [*(done(name).record for name in "abcd"), failed("e").record]
    monkeypatch.setattr("pcretrieve.catalogue.rows.PAGE", 2)
    pages = rows.pages(["d", "b", "nobody", "a"])
    assert [ids(page) for page in pages] == [["d", "b"], ["a"]]
    assert ids(records(rows, "failed")) == ["e"]
    assert rows.origins()[1] == Record("b", "/b.ply", "hash-b", "label", "done")
    assert rows.origins()[4] == Record("e", "/e.ply", "", None, "failed")
    rows.store(done("f", content_hash="hash-b"))
    assert ids(rows.several(["d", "nobody", "a", "d"])) == ["a", "d"]
    assert ids(rows.with_content("hash-b")) == ["b", "f"]
    rows.store(done("g", label=None))
    rows.store(done("h", label="other"))
    rows.store(failed("i", label="label"))
    assert rows.labelled(["other", "label", "nobody"]) == ["a", "b", "c", "d", "f", "h"]
    assert rows.labelled([]) == []


def test_wanted_shapes_are_those_of_a_sorted_list(rows: Rows) -> None:
    """All combinations of what is asked, against lists of Python."""
    bad = Grade("incomplete", 0.5, ("a hole",))
    added = "2026-01-0{}T23:59:59+00:00"
    rows.store(done("É", label="z", added=added.format(2), grade=bad))
    rows.store(done("B", label=None, added=added.format(1)))
    rows.store(failed("f", label="z", added=added.format(3)))
    rows.store(done("g", label="", added=added.format(3), grade=bad))
    rows.store(done("h", grade=Grade("poor", 0.9, ("noise",))))
    every = records(rows)
    keys = {
        "id": lambda one: one.id,
        "label": lambda one: (one.label is None, one.label or "", one.id),
        "added": lambda one: (one.added, one.id),
        "error": lambda one: (
            one.status == "failed",
            one.grade is not None,
            one.grade.error if one.grade else 0.0,
            one.id,
        ),
    }
    judged = {"": every, "incomplete": [one for one in every if one.is_incomplete]}
    for state in ("done", "failed"):
        judged[state] = [one for one in every if one.status == state]
    n_found = 0
    for state, label, days in product(judged, ("", "z"), DAYS):
        first, last = days or ("", "9")
        among = [one for one in judged[state] if first <= one.added[:10] <= last]
        among = [one for one in among if not label or one.label == label]
        for order, descending in product(keys, (False, True)):
            expected = ids(sorted(among, key=keys[order], reverse=descending))
            asked: dict[str, Any] = {"state": state, "label": label, "days": days}
            asked |= {"order": order, "descending": descending}
            assert rows.wanted(**asked) == (len(expected), expected)
            assert rows.wanted(**asked, limit=2, offset=1) == (
                len(expected),
                expected[1:3],
            )
            n_found += len(expected)
    assert n_found > 100
    rows.mark(["g", "a"], "rescan", "a foot is missing")
    rows.mark(["f"], "accept", None)
    assert rows.wanted(marked="rescan") == (2, ["a", "g"])
    assert rows.wanted(marked="any", state="failed") == (1, ["f"])
    assert rows.wanted(marked="note") == (0, [])
    assert sorted(rows.classes(9)) == ["", "label", "z"] and len(rows.classes(2)) == 2


def test_each_change_gives_the_rows_another_state(rows: Rows, new_location: str) -> None:
    """Of this connection and of others; also those that do not change the revision."""
    record = rows.record("a")
    with Rows(new_location, SETTINGS, create=False) as other:
        changes: list[Callable[[Rows], object]] = [
            lambda store: store.store(failed("new")),
            lambda store: store.store(failed("new", message="other")),
            lambda store: store.revise(
                moved={(path := store.record("b").path): path + "x"}
            ),
            lambda store: store.revise(labels={"/d.ply": "new label"}),
            lambda store: store.keep("digest", [(record, b"12345678")]),
            lambda store: store.remove("new"),
        ]
        states = [rows.state()]
        assert rows.state() == states[0]
        for change, store in product(changes[:-1], (other, rows)):
            change(store)
            states.append(rows.state())
            assert records(rows) and rows.state() == states[-1]
        changes[-1](other)
        states.append(rows.state())
    assert len(set(states)) == len(states) == 12


def test_signatures_are_listed_in_the_order_of_ids(rows: Rows) -> None:
    entry = rows.store(done("bb")), b"anew"
    rows.keep(
        "new",
        [
            entry,
            (done("a").record, b"of a"),
            (done("c", content_hash="old").record, b"late"),
        ],
    )
    for digest, has, packed in (
        (OWN, [True] * 5, b"".join(bytes([bits]) * 8 for bits in b"abbcd")),
        ("new", [True, False, True, False, False], b"of aanew"),
        ("none", [False] * 5, b""),
    ):
        found = rows.listed(digest)
        assert found.ids == ["a", "b", "bb", "c", "d"]
        assert (found.has.tolist(), bytes(found.packed)) == (has, packed)


def test_locations(tmp_path: Path) -> None:
    options = PipelineOptions().changed(signature={"n_values": 9})
    with Rows(tmp_path / "c.sqlite", settings_of(options), create=True) as rows:
        assert rows.location == str(tmp_path / "c.sqlite")
    with Catalogue(f"sqlite://{tmp_path / 'c.sqlite'}") as store:
        assert (store.location, store.options) == (str(tmp_path / "c.sqlite"), options)
    assert [path.name for path in tmp_path.iterdir()] == ["c.sqlite"]
    with pytest.raises(
        OptionError,
        match=r"must be a file, or a database at postgresql://.* got mysql://",
    ):
        Catalogue("mysql://host/shapes", create=True)
    with pytest.raises(CatalogueError, match="there is no catalogue"):
        Catalogue(Path("sqlite://rows"))


def test_a_failure_never_replaces_a_finished_shape(rows: Rows) -> None:
    """It replaces an earlier failure, and a shape replaces either."""
    before, revision = records(rows), rows.revision()
    assert rows.store(failed("a", id="another", content_hash="new")) == done("a").record
    assert (records(rows), rows.revision()) == (before, revision)
    (kept,) = rows.entries(["a"])
    assert (kept.signatures, kept.payloads) == (done("a").signatures, done("a").payloads)
    assert rows.store(failed("e", message="another reason")).message == "another reason"
    for name in "ae":
        assert (
            rows.store(done(name, content_hash="new"))
            == done(name, content_hash="new").record
        )
    assert ids(records(rows)) == ["a", "b", "c", "d", "e"]


def test_a_shape_does_not_take_the_path_of_another(rows: Rows) -> None:
    before = records(rows)
    rows.revise(moved={"/a.ply": "/b.ply"})
    assert records(rows) == before
    rows.revise(moved={"/a.ply": "/new.ply"})
    assert [record.path for record in rows.several(["a", "b"])] == ["/new.ply", "/b.ply"]


# --- marks ----------------------------------------------------------------------------------------------

WHY = "the left foot is missing"


def marked(record: Record) -> tuple[str | None, str | None]:
    return record.mark, record.note


def test_a_mark_stays_until_the_file_has_another_content(rows: Rows) -> None:
    rows.mark(["a", "e"], "rescan", WHY)
    assert rows.record("a") == replace(done("a").record, mark="rescan", note=WHY)
    assert rows.origins()[0].note == WHY
    # Processed again, failed again, moved.
    rows.store(done("a", area=3.0))
    rows.store(failed("e", message="another reason"))
    rows.revise(moved={"/a.ply": "/new.ply"}, labels={"/new.ply": "other"})
    assert marked(rows.record("a")) == marked(rows.record("e")) == ("rescan", WHY)
    with pytest.raises(InputError, match="holds no shape 'nobody'"):
        rows.mark(["b", "nobody"], "accept", None)
    assert marked(rows.record("b")) == (None, None)
    rows.mark(["e"], None, None)
    assert rows.record("e").mark is None
    # The person was scanned again.
    rows.store(done("a", path="/new.ply", content_hash="new"))
    assert marked(rows.record("a")) == (None, None)


def test_a_merge_keeps_the_marks_of_all_parts(tmp_path: Path) -> None:
    """The first one, if a shape has several; none, if it is of a file with another content."""
    other = failed("c", content_hash="other")
    parts = catalogues(tmp_path, done("a"), done("a"), done("b"), other, done("c"))
    for part, name, note in zip(parts[1:4], "abc", ("one", "two", "three"), strict=True):
        pr.mark(part, [name], "note", note)
    for number, order in enumerate((parts, parts[::-1])):
        whole = tmp_path / f"whole{number}.sqlite"
        merge_catalogues(order, whole)
        with Catalogue(whole) as store:
            notes = {record.id: record.note for record in store.records()}
        assert notes == {"a": "one", "b": "two", "c": None}
    merge_catalogues(parts[1:2], parts[0])
    with Catalogue(parts[0]) as store:
        assert marked(store.record("a")) == ("note", "one")
    pr.mark(parts[0], ["a"], "accept")
    merge_catalogues(parts[1:2], parts[0])
    with Catalogue(parts[0]) as store:
        assert marked(store.record("a")) == ("accept", None)
    pr.backup(parts[0], tmp_path / "copy.sqlite")
    with Catalogue(tmp_path / "copy.sqlite") as store:
        assert marked(store.record("a")) == ("accept", None)


def test_marks_are_those_that_are_known(tmp_path: Path) -> None:
    (path,) = catalogues(tmp_path, done("a"))
    for decision, note, said in (
        ("again", None, "must be one of rescan, accept, note, got 'again'"),
        ("note", "", "a note must have a text"),
    ):
        with pytest.raises(OptionError, match=said):
            pr.mark(path, ["a"], decision, note)
    with pytest.raises(OptionError, match="shape_ids"):
        pr.mark(path, "a", "accept")


# --- merges ---------------------------------------------------------------------------------------------


def catalogues(folder: Path, *entries: Entry) -> list[Path]:
    """A catalogue for each of some shapes."""
    paths: list[Path] = []
    for entry in entries:
        paths.append(folder / f"part{len(paths)}.sqlite")
        with Catalogue(paths[-1], create=True) as store:
            store.rows.store(entry)
    return paths


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (
            done("a", content_hash="other"),
            "/a.ply has different contents in .*part0.* and in .*part1",
        ),
        (
            done("a", label="other"),
            "/a.ply has the labels 'label' and 'other' in .*part0",
        ),
        (done("b", id="a"), "'a' is /a.ply in .*part0.* and /b.ply in .*part1"),
    ],
    ids=["contents", "labels", "ids"],
)
def test_conflicts_are_named_and_nothing_is_merged(
    other: Entry, said: str, tmp_path: Path
) -> None:
    parts = catalogues(tmp_path, done("a"), other)
    for order in (parts, parts[::-1]):
        with pytest.raises(
            CatalogueError, match="with conflicts cannot be merged: "
        ) as raised:
            merge_catalogues(order, tmp_path / "whole.sqlite")
        assert order is not parts or re.search(said, str(raised.value))
        assert not (tmp_path / "whole.sqlite").exists()
    # Also with what the target has.
    before = content(parts[0])
    with pytest.raises(CatalogueError, match="with conflicts cannot be merged: "):
        merge_catalogues(parts[1:], parts[0])
    assert content(parts[0]) == before


def test_a_shape_and_a_failure_of_another_content_are_no_conflict(tmp_path: Path) -> None:
    parts = catalogues(tmp_path, failed("a", content_hash="other"), done("a"))
    for number, order in enumerate((parts, parts[::-1])):
        merge_catalogues(order, tmp_path / f"whole{number}.sqlite")
        assert content(tmp_path / f"whole{number}.sqlite") == content(parts[1])


# --- PostgreSQL -----------------------------------------------------------------------------------------

SCHEMA = 'Some "people"'
QUOTED = '"Some ""people"""'


def opened(url: str, schema: str = SCHEMA, *, create: bool = False) -> Rows:
    return Rows(f"{url}?schema={schema}", SETTINGS, create=create)


@pytest.mark.slow
def test_schemas_are_catalogues_of_which_a_user_may_read_some(postgresql: str) -> None:
    import psycopg

    names = ["people", "people; DROP SCHEMA people", SCHEMA]
    for number, name in enumerate(names):
        with opened(postgresql, name, create=True) as rows:
            rows.add([failed(one) for one in "abc"[: number + 1]])
    for number, name in enumerate(names):
        with opened(postgresql, name) as rows:
            assert ids(records(rows)) == [*"abc"[: number + 1]]
    with psycopg.connect(postgresql, autocommit=True) as server:
        server.execute("CREATE ROLE reader LOGIN")
        url = postgresql.replace("tester", "reader")
        with pytest.raises(CatalogueError, match="there is no catalogue"):
            opened(url)
        with pytest.raises(
            CatalogueError, match=r"cannot be used by this user .*: grant the privileges"
        ):
            opened(url, "new", create=True)
        server.execute(f"GRANT USAGE ON SCHEMA {QUOTED} TO reader")
        server.execute(f"GRANT SELECT ON ALL TABLES IN SCHEMA {QUOTED} TO reader")
    with opened(url) as rows:
        assert ids(records(rows)) == [*"abc"]
        assert not rows.database.is_writable
        with pytest.raises(CatalogueError, match="cannot be used by this user"):
            rows.remove("a")


@pytest.mark.slow
def test_a_writer_waits_for_another_and_says_so(
    postgresql: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    import psycopg

    monkeypatch.setattr(postgresql_module, "LOCK_TIMEOUT", 0.05)
    with (
        opened(postgresql, "waiting", create=True) as rows,
        psycopg.connect(postgresql) as other,
    ):
        other.execute("SELECT value FROM waiting.meta WHERE key = 'revision' FOR UPDATE")
        assert records(rows) == []
        with pytest.raises(
            CatalogueError, match="is locked by another process: wait until"
        ):
            rows.store(failed("a"))
        other.rollback()
        rows.store(failed("a"))
        assert records(rows) == [failed("a").record]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("url", "said"),
    [
        (
            "postgresql://me:secret@127.0.0.1:1/none",
            "cannot be used: .*onnection.* refused",
        ),
        (
            "postgresql://me:secret@127.0.0.1:port/none",
            "must be postgresql://user@host:port/database",
        ),
        (
            "postgresql://me:sec@ret@127.0.0.1/none",
            "must be postgresql://user@host:port/database",
        ),
        ("postgresql://me:secret@127.0.0.1/none?color=red", 'cannot be used: .*"color"'),
    ],
)
def test_a_server_that_is_not_there(url: str, said: str) -> None:
    pytest.importorskip(
        "psycopg", reason="psycopg is not installed (the extra postgresql)"
    )
    with pytest.raises(CatalogueError, match=said) as raised:
        Catalogue(url, create=True)
    assert "secret" not in str(raised.value)
    assert isinstance(run("list", "-c", url, code=None).exception, CatalogueError)
