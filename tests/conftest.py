"""Puts this folder on the path, so that every test finds `shapes`, and keeps numpy to one thread.

Answers are the same to the bit only where sums are taken in one order.
"""

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from uuid import uuid4

import pytest

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# A shell starts background commands with SIGINT ignored, which their child processes would inherit: commands
# that tests interrupt would not notice.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def postgresql() -> Iterator[str]:
    """The URL of a database of a PostgreSQL server that runs until the tests have ended."""
    # Imported here, because only tests with this fixture need the server.
    from postgresql_server import running_server

    with running_server() as url:
        yield url


@pytest.fixture(params=["sqlite", "postgresql"])
def new_location(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """Where there is no catalogue yet, in each of the stores of pcretrieve."""
    if request.param == "sqlite":
        return str(tmp_path / "new.sqlite")
    return f"{request.getfixturevalue('postgresql')}?schema=new{uuid4().hex}"
