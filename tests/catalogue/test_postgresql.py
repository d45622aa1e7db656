"""Catalogues in a PostgreSQL database: what its server may do, and what other users of it see."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any
from uuid import uuid4

import pytest
from click.testing import CliRunner

from pcretrieve import Catalogue
from pcretrieve.catalogue import Record, postgresql as postgresql_module
from pcretrieve.catalogue.records import Entry
from pcretrieve.catalogue.rows import Rows
from pcretrieve.cli.main import cli
from pcretrieve.errors import CatalogueError

pytestmark = pytest.mark.slow

SETTINGS = {"options": "{}", "numbers_version": "7"}
FAILURE = Entry(Record("a", "/a", "", status="failed"), {}, {})


@pytest.fixture
def schema() -> str:
    return f'Some "bodies" {uuid4().hex}'


@pytest.fixture
def server(postgresql: str) -> Iterator[Any]:
    """A connection of another program."""
    import psycopg

    with psycopg.connect(postgresql, autocommit=True) as connection:
        yield connection


def quoted(schema: str) -> str:
    return '"{}"'.format(schema.replace('"', '""'))


def opened(url: str, schema: str, *, create: bool = False) -> Rows:
    return Rows(f"{url}?schema={schema}", SETTINGS, create=create)


def test_two_schemas_are_two_catalogues(postgresql: str, server: Any) -> None:
    names = ["people", 'Some "people"', "people; DROP SCHEMA people"]
    for number, name in enumerate(names):
        with opened(postgresql, name, create=True) as rows:
            rows.add([replace(FAILURE, record=Record(f"{one}", f"/{one}", "")) for one in range(number + 1)])
    for number, name in enumerate(names):
        with opened(postgresql, name) as rows:
            assert len(rows) == number + 1
    schemas = {name for (name,) in server.execute("SELECT nspname FROM pg_namespace").fetchall()}
    assert schemas >= set(names)


def test_a_user_without_privileges_reads_or_is_told(postgresql: str, schema: str, server: Any) -> None:
    with opened(postgresql, schema, create=True) as rows:
        rows.store(FAILURE)
    reader = f"reader{uuid4().hex}"
    server.execute(f"CREATE ROLE {reader} LOGIN")
    url = postgresql.replace("tester", reader)
    with pytest.raises(CatalogueError, match="there is no catalogue"):
        opened(url, schema)
    with pytest.raises(CatalogueError, match=r"cannot be used by this user .*: grant the privileges"):
        opened(url, "new", create=True)
    server.execute(f"GRANT USAGE ON SCHEMA {quoted(schema)} TO {reader}")
    server.execute(f"GRANT SELECT ON ALL TABLES IN SCHEMA {quoted(schema)} TO {reader}")
    with opened(url, schema) as rows:
        assert rows.records() == [FAILURE.record]
        assert not rows.database.is_writable
        with pytest.raises(CatalogueError, match="cannot be used by this user"):
            rows.remove("a")


def test_a_writer_waits_for_another_and_says_so(
    postgresql: str, schema: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    import psycopg

    monkeypatch.setattr(postgresql_module, "LOCK_TIMEOUT", 0.05)
    with opened(postgresql, schema, create=True) as rows, psycopg.connect(postgresql) as other:
        other.execute(f"SELECT value FROM {quoted(schema)}.meta WHERE key = 'revision' FOR UPDATE")
        assert rows.records() == []
        with pytest.raises(CatalogueError, match="is locked by another process: wait until"):
            rows.store(FAILURE)
        other.rollback()
        rows.store(FAILURE)
        assert rows.records() == [FAILURE.record]


@pytest.mark.parametrize(
    ("url", "said"),
    [
        ("postgresql://me:secret@127.0.0.1:1/none", "cannot be used: .*onnection.* refused"),
        ("postgresql://me:secret@127.0.0.1:port/none", "must be postgresql://user@host:port/database"),
        ("postgresql://me:sec@ret@127.0.0.1/none", "must be postgresql://user@host:port/database"),
        ("postgresql://me:secret@127.0.0.1/none?color=red", 'cannot be used: .*"color"'),
    ],
)
def test_a_server_that_is_not_there(url: str, said: str) -> None:
    pytest.importorskip("psycopg", reason="psycopg is not installed (the extra postgresql)")
    with pytest.raises(CatalogueError, match=said) as raised:
        Catalogue(url, create=True)
    assert "secret" not in str(raised.value)
    assert isinstance(CliRunner().invoke(cli, ["list", "-c", url]).exception, CatalogueError)
