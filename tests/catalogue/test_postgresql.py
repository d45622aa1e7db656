"""Catalogues in a PostgreSQL database: what its server may do, and what other users of it see."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
import pytest
from benchmarks.catalogue import OPTIONS
from benchmarks.synthetic import synthetic_catalogue, synthetic_id
from click.testing import CliRunner
from postgresql_server import has_pgvector, programs

from pcretrieve import Catalogue
from pcretrieve.catalogue import Record, export_vectors
from pcretrieve.catalogue import postgresql as postgresql_module
from pcretrieve.catalogue.copies import VECTOR_TABLE, write_vectors
from pcretrieve.catalogue.records import Entry
from pcretrieve.catalogue.rows import Rows
from pcretrieve.cli.main import cli
from pcretrieve.errors import CatalogueError, InputError

pytestmark = pytest.mark.slow

SETTINGS = {"options": "{}", "numbers_version": "7"}
FAILURE = Entry(Record("a", "/a", "", status="failed"), {}, {})
N_SHAPES = 400


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


# --- vectors --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("whitening", ["none", "pca"])
def test_the_database_gives_the_order_of_the_index(postgresql: str, tmp_path: Path, whitening: str) -> None:
    if not has_pgvector(programs()):
        pytest.skip("the PostgreSQL server has no pgvector (Debian 13: postgresql-17-pgvector)")
    import psycopg

    url, bodies = postgresql, tmp_path / "bodies.sqlite"
    synthetic_catalogue(bodies, OPTIONS, N_SHAPES, seed=3)
    options = OPTIONS.changed(retrieval={"whitening": whitening})
    table = f"by_{whitening}"
    with Catalogue(bodies) as catalogue, psycopg.connect(url) as connection:
        assert export_vectors(catalogue, url, options, table=table) == N_SHAPES
        with pytest.raises(InputError, match="the table must be new, got 'by_"):
            export_vectors(catalogue, url, options, table=table)
        index = catalogue.index(options)
        for number in range(0, N_SHAPES, 37):
            rows = connection.execute(
                f"SELECT b.id, b.label, a.signature <-> b.signature FROM {table} a, {table} b "
                "WHERE a.id = %s ORDER BY a.signature <-> b.signature, b.id LIMIT 10",
                [synthetic_id(number)],
            ).fetchall()
            found = index.nearest(synthetic_id(number), 10)
            assert tuple(row[0] for row in rows) == found.ids
            assert rows[0][1] == f"class-{number // 10:06}"
            np.testing.assert_allclose([row[2] for row in rows], found.distances, rtol=1e-5, atol=1e-6)
    with pytest.raises(InputError, match=r"cannot write to PostgreSQL: .*duplicate key"):
        write_vectors(url, f"twice_{whitening}", ["a", "a"], [None, None], np.ones((2, 3)))
    done = CliRunner().invoke(cli, ["export", "-c", str(bodies), "--to", url, "--whitening", whitening])
    assert done.exit_code == 0, done.output
    with psycopg.connect(url, autocommit=True) as connection:
        assert connection.execute("SELECT to_regclass(%s)", [f"twice_{whitening}"]).fetchone() == (None,)
        assert connection.execute(f"SELECT count(*) FROM {VECTOR_TABLE}").fetchone() == (N_SHAPES,)
        connection.execute(f"DROP TABLE {VECTOR_TABLE}")
