"""Catalogues in a PostgreSQL database: what its server may do, and what other users of it see."""

from __future__ import annotations

import secrets
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
import pytest
from benchmarks.catalogue import OPTIONS
from click.testing import CliRunner

from pcretrieve import Catalogue
from pcretrieve.catalogue import Record, database, gallery, postgresql_tables
from pcretrieve.catalogue.arrays import packed_values
from pcretrieve.catalogue.checksums import CHECKSUM_COLUMNS
from pcretrieve.catalogue.stores import open_rows
from pcretrieve.cli.main import cli
from pcretrieve.errors import CatalogueError

SETTINGS = {"options": "{}", "numbers_version": "7"}


@pytest.fixture
def location(postgresql: str) -> str:
    return f'{postgresql}?schema=Some "bodies" {uuid4().hex}'


@pytest.fixture
def server(postgresql: str) -> Iterator[Any]:
    """A connection of another program."""
    import psycopg

    with psycopg.connect(postgresql, autocommit=True) as connection:
        yield connection


def test_two_schemas_are_two_catalogues(postgresql: str, server: Any) -> None:
    names = ["people", 'Some "people"', "people; DROP SCHEMA people"]
    for number, name in enumerate(names):
        with closing(open_rows(f"{postgresql}?schema={name}", SETTINGS, create=True)) as rows:
            for shape in range(number + 1):
                rows.put(Record(f"{shape}", f"/{shape}", "", status="failed"), None, {})
    for number, name in enumerate(names):
        with closing(open_rows(f"{postgresql}?schema={name}", SETTINGS, create=False)) as rows:
            assert rows.count("failed") == number + 1
    schemas = {name for (name,) in server.execute("SELECT nspname FROM pg_namespace").fetchall()}
    assert schemas >= set(names)


def test_a_user_without_privileges_reads_or_is_told(location: str, postgresql: str, server: Any) -> None:
    with closing(open_rows(location, SETTINGS, create=True)) as rows:
        rows.put(Record("a", "/a", "", status="failed"), None, {})
    reader = f"reader{uuid4().hex}"
    schema = location.partition("=")[2].replace('"', '""')
    server.execute(f"CREATE ROLE {reader} LOGIN")
    others = location.replace("tester", reader)
    with pytest.raises(CatalogueError, match="there is no catalogue"):
        open_rows(others, SETTINGS, create=False)
    with pytest.raises(CatalogueError, match=r"cannot be used by this user .*: grant the privileges"):
        open_rows(f"{postgresql.replace('tester', reader)}?schema=new", SETTINGS, create=True)
    server.execute(f'GRANT USAGE ON SCHEMA "{schema}" TO {reader}')
    server.execute(f'GRANT SELECT ON ALL TABLES IN SCHEMA "{schema}" TO {reader}')
    with closing(open_rows(others, SETTINGS, create=False)) as rows:
        assert [record.id for record in rows.page(limit=9)] == ["a"]
        assert not rows.is_writable
        with pytest.raises(CatalogueError, match="cannot be used by this user"):
            rows.remove(["a"])


def test_what_no_text_of_a_database_may_hold(location: str) -> None:
    """A message of an error with the character 0, and a path as long as Linux allows."""
    path = "/" + secrets.token_hex(2047)
    with closing(open_rows(location, SETTINGS, create=True)) as rows:
        rows.put(Record("a", path, "", status="failed", message="what\0said"), None, {})
        stored = rows.put(Record("a", path, "", "la\0bel", status="failed", message="what\0said"), None, {})
        assert rows.page(limit=9) == [stored]
        assert (stored.path, stored.message, stored.label) == (path, "what␀said", "la␀bel")
        rows.revise(moved={path: "/b"}, removed=[], labels={"/b": "new\0"}, stamps={})
        assert [(record.path, record.label) for record in rows.page(limit=9)] == [("/b", "new␀")]


# --- other processes ------------------------------------------------------------------------------------


def test_of_several_that_make_one_catalogue_each_gets_the_same(location: str) -> None:
    def put(number: int) -> str:
        with closing(open_rows(location, SETTINGS | {"by": str(number)}, create=True)) as rows:
            rows.put(Record(f"{number}", f"/{number}", "", status="failed"), None, {})
            return rows.settings()["by"]

    with ThreadPoolExecutor(8) as several:
        assert len(set(several.map(put, range(8)))) == 1
    with closing(open_rows(location, SETTINGS, create=False)) as rows:
        assert rows.count("failed") == 8


def test_a_catalogue_outlives_its_connections(location: str, server: Any) -> None:
    with closing(open_rows(location, SETTINGS, create=True)) as rows:
        server.execute("SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE pid <> pg_backend_pid()")
        rows.put(Record("a", "/a", "", status="failed"), None, {})
        assert rows.count("failed") == 1


def test_a_writer_waits_for_another_and_says_so(
    location: str, postgresql: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    import psycopg

    monkeypatch.setattr(database, "LOCK_TIMEOUT", 0.05)
    schema = location.partition("=")[2].replace('"', '""')
    with (
        closing(open_rows(location, SETTINGS, create=True)) as rows,
        psycopg.connect(postgresql) as other,
    ):
        other.execute(f"SELECT value FROM \"{schema}\".meta WHERE key = 'revision' FOR UPDATE")
        assert rows.count("failed") == 0
        with pytest.raises(
            CatalogueError, match="is locked by another process: wait until that has finished"
        ):
            rows.put(Record("a", "/a", "", status="failed"), None, {})
        other.rollback()
        rows.put(Record("a", "/a", "", status="failed"), None, {})
        assert rows.count("failed") == 1


def test_a_gallery_notices_what_others_added(
    location: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(gallery, "SMALLEST_KEPT", 3)
    rng = np.random.default_rng(0)
    with (
        Catalogue(location, OPTIONS, create=True) as catalogue,
        closing(open_rows(location, {}, create=False)) as other,
    ):

        def put(name: str) -> None:
            values = packed_values(np.sort(rng.uniform(size=OPTIONS.signature.n_values))[::-1])
            other.put(Record(name, f"/{name}", name, area=1.0), values, {})

        for name in "abc":
            put(name)
        before = catalogue.index()
        assert catalogue.index() is before
        assert len(list(tmp_path.glob("pcretrieve/*/*"))) == 1
        put("d")
        assert len(before) == 3
        assert len(catalogue.index()) == 4
        assert len(list(tmp_path.glob("pcretrieve/*/*"))) == 1


# --- migration ------------------------------------------------------------------------------------------

LATER = postgresql_tables.SCHEMA_VERSION + 1
# Fails if it is executed twice.
NEW_COLUMN = "ALTER TABLE shapes ADD COLUMN colour text DEFAULT 'grey'"


def later_version(monkeypatch: pytest.MonkeyPatch, *statements: str) -> None:
    """Let pcretrieve be one whose schema has one more version."""
    monkeypatch.setattr(postgresql_tables, "SCHEMA_VERSION", LATER)
    monkeypatch.setattr(postgresql_tables, "MIGRATIONS", {LATER - 1: statements})


def test_a_catalogue_of_an_earlier_version_is_migrated_once(
    location: str, server: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    with closing(open_rows(location, SETTINGS, create=True)) as rows:
        rows.put(Record("a", "/a", "", status="failed"), None, {})
    later_version(monkeypatch, NEW_COLUMN, "UPDATE shapes SET colour = 'blue'")

    def opened(number: int) -> list[Record]:
        with closing(open_rows(location, SETTINGS, create=False)) as rows:
            return rows.page(limit=10)

    with ThreadPoolExecutor(4) as several:
        assert [[record.id for record in page] for page in several.map(opened, range(4))] == [["a"]] * 4
    schema = location.partition("=")[2].replace('"', '""')
    assert server.execute(f'SELECT colour FROM "{schema}".shapes').fetchall() == [("blue",)]
    monkeypatch.undo()
    with pytest.raises(CatalogueError, match=rf"by a newer pcretrieve \(schema {LATER}, this one knows"):
        open_rows(location, SETTINGS, create=False)


def test_a_migration_that_fails_changes_nothing(location: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with closing(open_rows(location, SETTINGS, create=True)) as rows:
        rows.put(Record("a", "/a", "", status="failed"), None, {})
    later_version(monkeypatch, NEW_COLUMN, "UPDATE nothing SET colour = 'blue'")
    with pytest.raises(CatalogueError, match=r'cannot be used: .*"nothing" does not exist'):
        open_rows(location, SETTINGS, create=False)
    later_version(monkeypatch, NEW_COLUMN)
    with closing(open_rows(location, SETTINGS, create=False)) as rows:
        assert rows.count("failed") == 1


def test_a_catalogue_of_version_3_gets_checksums(location: str, server: Any) -> None:
    with closing(open_rows(location, SETTINGS, create=True)) as rows:
        rows.put(Record("a", "/a", "", "label", status="failed", message="what\0said"), None, {})
        before = rows.page(limit=10)
    schema = location.partition("=")[2].replace('"', '""')
    server.execute(f'SET search_path = "{schema}"')
    for column in ("stamp", *CHECKSUM_COLUMNS.values()):
        server.execute(f"ALTER TABLE shapes DROP COLUMN {column}")
    server.execute("UPDATE meta SET value = '3' WHERE key = 'schema_version'")
    with closing(open_rows(location, SETTINGS, create=False)) as rows:
        assert rows.page(limit=10) == before
        server.execute("UPDATE shapes SET label = 'labem'")
        with pytest.raises(CatalogueError, match="its label 'labem' has changed since it was stored"):
            rows.page(limit=10)


# --- what cannot be opened ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("url", "said"),
    [
        ("postgresql://me:secret@127.0.0.1:1/none", "cannot be used: .*onnection.* refused"),
        ("postgresql://me:secret@127.0.0.1:port/none", "must be postgresql://user@host:port/database"),
        ("postgresql://me:secret@127.0.0.1/none?color=red", 'cannot be used: .*"color"'),
    ],
)
def test_a_server_that_is_not_there(url: str, said: str) -> None:
    pytest.importorskip("sqlalchemy", reason="SQLAlchemy is not installed (the extra postgresql)")
    pytest.importorskip("psycopg", reason="psycopg is not installed (the extra postgresql)")
    with pytest.raises(CatalogueError, match=said) as raised:
        Catalogue(url, create=True)
    assert "secret" not in str(raised.value)
    told = CliRunner().invoke(cli, ["list", "-c", url])
    assert isinstance(told.exception, CatalogueError)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("SET value = '99' WHERE key = 'schema_version'", r"newer pcretrieve \(schema 99"),
        ("SET value = 'x' WHERE key = 'schema_version'", r"is damaged \(it has no version\)"),
        ("SET key = 'x' WHERE key = 'revision'", r"is damaged \(it has no revision\)"),
    ],
)
def test_a_catalogue_that_cannot_be_understood(change: str, said: str, location: str, server: Any) -> None:
    open_rows(location, SETTINGS, create=True).close()
    schema = location.partition("=")[2].replace('"', '""')
    server.execute(f'UPDATE "{schema}".meta {change}')
    with (
        pytest.raises(CatalogueError, match=said),
        closing(open_rows(location, SETTINGS, create=False)) as rows,
    ):
        rows.revision()


def test_a_database_of_another_encoding_is_refused(postgresql: str, server: Any, tmp_path: Path) -> None:
    name = f"latin{uuid4().hex}"
    server.execute(f"CREATE DATABASE {name} ENCODING 'LATIN1' LOCALE 'C' TEMPLATE template0")
    with pytest.raises(CatalogueError, match="must be a database with the encoding UTF8"):
        open_rows(postgresql.replace("/postgres", f"/{name}"), SETTINGS, create=True)
