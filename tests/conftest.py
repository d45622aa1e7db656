"""Puts this folder on the path, so that every test finds `shapes`, and keeps numpy to one thread.

Answers are the same to the bit only where sums are taken in one order.
"""

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING
from uuid import uuid4

import pytest

if TYPE_CHECKING:
    from dask_cluster import DaskCluster
    from playwright.sync_api import Browser
    from search_server import Server

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Indexes of the catalogues of the tests, which their processes store in the cache of the user.
CACHE = TemporaryDirectory(prefix="pcretrieve-cache-", ignore_cleanup_errors=True)
os.environ["XDG_CACHE_HOME"] = CACHE.name

# A shell starts background commands with SIGINT ignored, which their child processes would inherit: commands
# that tests interrupt would not notice.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


# Fixtures import what they start: only tests that need it have it.


@pytest.fixture(scope="session")
def postgresql() -> Iterator[str]:
    """The URL of a database of a PostgreSQL server that runs until the tests have ended."""
    from postgresql_server import running_server

    with running_server() as url:
        yield url


@pytest.fixture(scope="session")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> "Iterator[DaskCluster]":
    """A Dask cluster of two workers that runs until the tests have ended."""
    pytest.importorskip(
        "distributed", reason="distributed is not installed (the extra cluster)"
    )
    from dask_cluster import dask_cluster

    with dask_cluster(tmp_path_factory.mktemp("dask") / "cluster") as started:
        yield started


@pytest.fixture(scope="session")
def eggs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A catalogue of eggs, which no test changes."""
    from search_server import write_eggs

    path = tmp_path_factory.mktemp("eggs") / "eggs.sqlite"
    write_eggs(path)
    return path


@pytest.fixture(scope="session")
def server(eggs: Path) -> "Iterator[Server]":
    """The search page of the eggs, until the tests have ended."""
    from search_server import running

    with running(eggs) as started:
        yield started


@pytest.fixture(scope="module")
def browser() -> "Iterator[Browser]":
    """A browser for the tests of one module; see `browsers.chromium`."""
    from browsers import chromium

    with chromium() as started:
        yield started


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.slow)])
def new_location(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """Where there is no catalogue yet, in each of the stores of pcretrieve."""
    if request.param == "sqlite":
        return str(tmp_path / "new.sqlite")
    return f"{request.getfixturevalue('postgresql')}?schema=new{uuid4().hex}"
