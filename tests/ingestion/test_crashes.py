"""An ingest that is killed again and again, at any moment, makes the catalogue of an undisturbed one.

By default it is killed a few times; PCRETRIEVE_KILLS says how often, also with a Dask cluster of this
computer.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import shapes
from processes import PATIENCE, living, wait_for
from stored import Everything, everything

from pcretrieve import Catalogue, ingest, status
from pcretrieve.catalogue import find_defects
from pcretrieve.errors import CatalogueError
from pcretrieve.formats import write_mesh

N_KILLS = int(os.environ.get("PCRETRIEVE_KILLS", "3"))

# At most two shapes for each kill; when all are stored, they are removed, and stored again.
N_SHAPES = 2 * N_KILLS + 2

# A cluster takes five seconds to start.
EXECUTORS = ["local", "dask"] if "PCRETRIEVE_KILLS" in os.environ else ["local"]


@pytest.fixture(scope="module")
def scans(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of eggs, all of them different."""
    folder = tmp_path_factory.mktemp("crashes") / "scans"
    folder.mkdir()
    for number in range(N_SHAPES):
        egg = shapes.ellipsoid((1, 1.2, 1.5 + number / N_SHAPES), subdivisions=2)
        write_mesh(egg, folder / f"egg{number:03}.off")
    return folder


@pytest.fixture(scope="module")
def undisturbed(scans: Path) -> Everything:
    """What an ingest stores that nobody kills."""
    location = scans.parent / "undisturbed.sqlite"
    ingest(scans, location, workers=2)
    return everything(str(location))


def stored(location: str) -> Everything:
    """What is stored, none of which is damaged; nothing before there is a catalogue."""
    try:
        with Catalogue(location) as store:
            assert find_defects(store) == []
    except CatalogueError as error:
        assert "there is no catalogue" in error.message
        return {}
    return everything(location)


def n_stored(location: str) -> int:
    with suppress(CatalogueError), Catalogue(location) as store:
        return len(store)
    return 0


@pytest.mark.slow
@pytest.mark.parametrize("executor", EXECUTORS)
def test_killed_at_any_moment(
    executor: str,
    new_location: str,
    scans: Path,
    undisturbed: Everything,
    tmp_path: Path,
    request: pytest.FixtureRequest,
) -> None:
    cluster = None if executor == "local" else request.getfixturevalue("cluster")
    where = () if cluster is None else ("--scheduler-file", str(cluster.file))
    (tmp_path / "temporary").mkdir()
    command = [sys.executable, "-m", "pcretrieve", "ingest", str(scans), "-c", new_location, "--workers", "2"]
    environment = os.environ | {"TMPDIR": str(tmp_path / "temporary")}
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}

    def start() -> subprocess.Popen[str]:
        """An ingest in a process group of its own."""
        whole = [*command, *where]
        return subprocess.Popen(whole, cwd=tmp_path, env=environment, start_new_session=True, **pipes)

    rng = random.Random(executor)
    there: Everything = {}
    for kill in range(N_KILLS):
        process = start()
        # Every fourth one while processes start, the others after some shapes more, and a moment later.
        if kill % 4 == 0:
            time.sleep(rng.uniform(0, 3))
        else:
            wanted = min(len(there) + rng.randrange(1, 4), N_SHAPES)
            assert wait_for(lambda: process.poll() is not None or n_stored(new_location) >= wanted)  # noqa: B023
            time.sleep(rng.uniform(0, 0.02))
        has_ended = process.poll() is not None
        with suppress(ProcessLookupError):  # it has ended, and its child processes, too
            os.killpg(process.pid, signal.SIGKILL)
        said, _ = process.communicate(timeout=PATIENCE)
        assert not has_ended or process.returncode == 0, said
        assert wait_for(lambda: not living(process.pid))  # noqa: B023
        before, there = there, stored(new_location)
        assert before.items() <= there.items()  # nothing is lost
        assert there.items() <= undisturbed.items()  # and nothing is stored that is not whole
        if len(there) == N_SHAPES and kill < N_KILLS - 1:  # the next kills find an ingest at work, too
            with Catalogue(new_location) as catalogue:
                catalogue.remove(*there)
            there = {}
    process = start()
    said, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, said
    assert stored(new_location) == undisturbed
    assert status(new_location).state == "finished"
    assert [*(tmp_path / "temporary").glob("pcretrieve-*")] == []
    assert {path.name for path in tmp_path.iterdir()} <= {"temporary", "new.sqlite"}
