"""Signatures as vectors of a PostgreSQL server with pgvector, which gives the order of our index."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from benchmarks.catalogue import OPTIONS
from benchmarks.synthetic import synthetic_catalogue, synthetic_id
from click.testing import CliRunner
from postgresql_server import has_pgvector, programs

from pcretrieve.catalogue import Catalogue
from pcretrieve.catalogue.pgvector import write_vectors
from pcretrieve.catalogue.vectors import VECTOR_TABLE, export_vectors
from pcretrieve.cli.main import cli
from pcretrieve.errors import InputError, OptionError

N_SHAPES = 400


@pytest.fixture
def url(postgresql: str) -> str:
    if not has_pgvector(programs()):
        pytest.skip("the PostgreSQL server has no pgvector (Debian 13: postgresql-17-pgvector)")
    return postgresql


@pytest.fixture(scope="module")
def location(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("catalogue") / "bodies.sqlite"
    synthetic_catalogue(path, OPTIONS, N_SHAPES, seed=3)
    return path


@pytest.mark.parametrize("whitening", ["none", "pca", "within-class"])
def test_the_database_gives_the_order_of_the_index(url: str, location: Path, whitening: str) -> None:
    import psycopg

    options = OPTIONS.changed(retrieval={"whitening": whitening})
    table = f"by_{whitening.replace('-', '_')}"
    with Catalogue(location) as catalogue, psycopg.connect(url) as connection:
        assert export_vectors(catalogue, url, options, table=table) == N_SHAPES
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


def test_a_table_is_written_whole_or_not_at_all(url: str, location: Path) -> None:
    import psycopg

    with Catalogue(location) as catalogue:
        ids = [synthetic_id(7), synthetic_id(3)]
        assert export_vectors(catalogue, url, OPTIONS, shape_ids=ids, table="two") == 2
        with pytest.raises(InputError, match="the table must be new, got 'two'"):
            export_vectors(catalogue, url, OPTIONS, table="two")
    with pytest.raises(InputError, match=r"cannot write to PostgreSQL: .*duplicate key"):
        write_vectors(url, "twice", ["a", "a"], [None, None], np.ones((2, 3)))
    with psycopg.connect(url) as connection:
        assert connection.execute("SELECT id FROM two ORDER BY id").fetchall() == [(ids[1],), (ids[0],)]
        assert connection.execute("SELECT to_regclass('twice')").fetchone() == (None,)


def test_only_log_is_the_distance_of_vectors(location: Path) -> None:
    with Catalogue(location) as catalogue, pytest.raises(OptionError, match=r"must be log .* got 'd1'"):
        export_vectors(catalogue, "", OPTIONS.changed(retrieval={"distance": "d1"}))


def test_a_server_that_is_not_there(location: Path) -> None:
    pytest.importorskip("psycopg", reason="psycopg is not installed (the extra postgresql)")
    with Catalogue(location) as catalogue, pytest.raises(InputError, match="cannot write to PostgreSQL"):
        export_vectors(catalogue, "postgresql://nobody@127.0.0.1:1/none", OPTIONS)


def test_the_command_writes_all_signatures(url: str, location: Path) -> None:
    import psycopg

    done = CliRunner().invoke(cli, ["export", "-c", str(location), "--to", url, "--whitening", "pca"])
    assert done.exit_code == 0, done.output
    with psycopg.connect(url) as connection:
        (row,) = connection.execute(f"SELECT count(*), max(label) FROM {VECTOR_TABLE}").fetchall()
    assert row == (N_SHAPES, f"class-{N_SHAPES // 10 - 1:06}")


@pytest.mark.parametrize("given", [[], ["--to", "postgresql://x", "-o", "y"], ["--to", "x", "--signatures"]])
def test_the_command_writes_to_one_place(given: list[str], location: Path) -> None:
    done = CliRunner().invoke(cli, ["export", "-c", str(location), *given])
    assert done.exit_code == 2
    assert "give either --output, or --to" in done.output
