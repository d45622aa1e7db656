"""Signatures as vectors of a PostgreSQL server with pgvector, which gives the order of our index.

The server is a throw-away cluster in a temporary folder, if its programs (those of PATH, of Debian, or of the
folder PCRETRIEVE_POSTGRESQL) and the extension are installed.
"""

from __future__ import annotations

import os
import pwd
import shutil
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from pcretrieve.adapters.postgresql import write_vectors
from pcretrieve.benchmarks.catalogue import OPTIONS
from pcretrieve.benchmarks.synthetic import synthetic_catalogue, synthetic_id
from pcretrieve.catalogue import Catalogue
from pcretrieve.catalogue.vectors import VECTOR_TABLE, export_vectors
from pcretrieve.cli.main import cli
from pcretrieve.errors import InputError, OptionError

N_SHAPES = 400


def programs() -> Path:
    """The folder of the programs of a PostgreSQL server that has pgvector."""
    given = os.environ.get("PCRETRIEVE_POSTGRESQL")
    on_path = shutil.which("pg_config")
    folders = [Path(given)] if given else []
    folders += sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True)
    folders += [Path(on_path).resolve().parent] if on_path else []
    for folder in folders:
        if (config := folder / "pg_config").exists() and (folder / "initdb").exists():
            command: list[str | Path] = [config, "--sharedir"]
            shared = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
            if (Path(shared) / "extension" / "vector.control").exists():
                return folder
    pytest.skip("no PostgreSQL server with pgvector is installed (Debian: postgresql-17-pgvector)")


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A database of a server that runs until the tests of this module have ended."""
    pytest.importorskip("psycopg", reason="psycopg is not installed (the extra postgresql)")
    tools = programs()
    folder = tmp_path_factory.mktemp("postgresql")
    as_user: dict[str, Any] = {}
    if os.geteuid() == 0:  # PostgreSQL refuses to run as root
        nobody = pwd.getpwnam("nobody")
        as_user = {"user": nobody.pw_uid, "group": nobody.pw_gid, "extra_groups": []}
        folder = Path(shutil.copytree(folder, f"/tmp/pcretrieve-postgresql-{os.getpid()}"))
        os.chown(folder, nobody.pw_uid, nobody.pw_gid)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    data = folder / "data"

    def run(*command: str | Path) -> None:
        subprocess.run(command, check=True, cwd=folder, capture_output=True, timeout=100, **as_user)

    run(tools / "initdb", "-D", data, "-U", "tester", "-A", "trust", "--no-sync")
    settings = f"-c listen_addresses=127.0.0.1 -c port={port} -c unix_socket_directories={folder}"
    run(tools / "pg_ctl", "-D", data, "-w", "-l", folder / "log", "-o", settings, "start")
    try:
        yield f"postgresql://tester@127.0.0.1:{port}/postgres"
    finally:
        run(tools / "pg_ctl", "-D", data, "-m", "immediate", "stop")
        shutil.rmtree(folder)


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
