"""Scans that the workers of a Dask cluster process: each has one outcome, whatever process is killed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import shapes
from commands import program
from dask_cluster import DaskCluster, dask_cluster
from processes import wait_for as until

from pcretrieve import Catalogue, DaskExecutor, ingest
from pcretrieve.errors import InputError, PcretrieveError, WorkerDied
from pcretrieve.formats import write_mesh
from pcretrieve.gallery.fitted import signatures
from pcretrieve.ingestion import cluster as cluster_module

pytest.importorskip(
    "distributed", reason="distributed is not installed (the extra cluster)"
)

LIMITS: dict[str, Any] = {"workers": None, "timeout": 60.0, "memory": None}
PATIENCE = 120  # seconds


@pytest.fixture
def own_cluster(tmp_path: Path) -> Iterator[DaskCluster]:
    """A cluster whose processes a test may kill."""
    with dask_cluster(tmp_path / "cluster") as started:
        yield started


def own_process(number: int) -> int:
    return os.getpid()


def end_dask_worker(number: int) -> int:
    """Kill the Dask worker, whose child process this is."""
    if number == 3:
        os.kill(os.getppid(), signal.SIGKILL)
        time.sleep(PATIENCE)
    return number


def wait_for(file: Path, number: int) -> int:
    """Wait until a file is there; leave a file that says that this item has begun."""
    file.with_suffix(f".begun{number}").touch()
    while not file.exists():
        time.sleep(0.05)
    return number


@pytest.mark.slow
def test_a_scan_that_ends_one_dask_worker_after_the_other_fails_alone(
    own_cluster: DaskCluster,
) -> None:
    """The nannies start the workers again, until the scheduler gives the chunk up."""
    outcomes = dict(
        DaskExecutor(scheduler_file=own_cluster.file)(end_dask_worker, range(6), **LIMITS)
    )
    assert isinstance(outcomes.pop(3), WorkerDied)
    assert outcomes == {number: number for number in (0, 1, 2, 4, 5)}


@pytest.mark.slow
@pytest.mark.parametrize("lose", [signal.SIGKILL, signal.SIGSTOP])
def test_items_of_a_lost_computer_are_processed_by_another_one(
    lose: signal.Signals, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One whose processes are stopped answers no more, and keeps its connections."""
    # Time after which the scheduler gives up a worker that does not answer, by default five minutes.
    monkeypatch.setenv("DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL", "5s")
    file = tmp_path / "go"
    with dask_cluster(tmp_path / "cluster") as own_cluster:
        executor = DaskExecutor(scheduler_file=own_cluster.file)
        with closing(executor(partial(wait_for, file), range(4), **LIMITS)) as outcomes:
            # The first outcome is asked for by another thread, because it needs the file.
            found: list[tuple[int, object]] = []
            reader = threading.Thread(target=lambda: found.extend(outcomes))
            reader.start()
            assert until(lambda: len(list(tmp_path.glob("go.begun*"))) == 2)
            os.killpg(own_cluster.workers[0].pid, lose)
            file.touch()
            reader.join(PATIENCE)
    assert sorted(found) == [(number, number) for number in range(4)]


@pytest.mark.slow
def test_a_scheduler_that_ends_is_an_error_with_words(
    own_cluster: DaskCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster_module, "CONNECT_TIMEOUT", 5.0)
    outcomes = DaskExecutor(scheduler_file=own_cluster.file)(
        own_process, iter(range(10**9)), **LIMITS
    )
    next(outcomes)
    own_cluster.kill(own_cluster.scheduler)
    with pytest.raises(
        PcretrieveError, match="the scheduler has ended: the same command"
    ):
        list(outcomes)


@pytest.mark.slow
def test_what_dask_prints_does_not_precede_the_error(
    own_cluster: DaskCluster, tmp_path: Path
) -> None:
    write_mesh(shapes.ellipsoid((1, 1, 2), subdivisions=2), tmp_path / "egg.off")
    for worker in own_cluster.workers:
        own_cluster.kill(worker)
    words = [
        "ingest",
        "egg.off",
        "--scheduler-file",
        own_cluster.file,
        "--log-file",
        "log",
    ]
    with subprocess.Popen(
        [sys.executable, "-m", "pcretrieve", *map(str, words), "-c", "c.sqlite"],
        cwd=tmp_path,
        stderr=subprocess.PIPE,
        text=True,
    ) as ingesting:
        assert ingesting.stderr is not None
        for line in ingesting.stderr:
            if "no workers now" in line:
                break
        own_cluster.kill(own_cluster.scheduler)
        said = ingesting.stderr.read()
    assert said.startswith("Error: the connection to the Dask scheduler was lost")
    assert said.count("\n") == 1
    assert "distributed.client: Failed to reconnect" in (tmp_path / "log").read_text()


@pytest.mark.parametrize("content", [b"{}", b"nonsense", b"\xff\0", b'{"address": 5}'])
def test_a_file_that_is_none_of_a_scheduler_is_an_error(
    tmp_path: Path, content: bytes
) -> None:
    file = tmp_path / "scheduler.json"
    file.write_bytes(content)
    with pytest.raises(PcretrieveError, match=r"no Dask scheduler answers at .*json: \S"):
        list(DaskExecutor(scheduler_file=file)(own_process, range(3), **LIMITS))


@pytest.mark.slow
def test_processes_stay_for_the_next_item_and_end_with_the_ingest(
    cluster: DaskCluster,
) -> None:
    outcomes = dict(
        DaskExecutor(scheduler_file=cluster.file)(own_process, range(40), **LIMITS)
    )
    numbers = set(outcomes.values())
    assert len(numbers) == 2, "one process for each thread of the cluster"
    assert until(lambda: not any(Path(f"/proc/{number}").exists() for number in numbers))


@pytest.mark.slow
def test_workers_of_other_versions_are_an_error(
    cluster: DaskCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        cluster_module, "versions", lambda: {"pcretrieve": "0.0.1", "numpy": "1.0"}
    )
    with pytest.raises(
        PcretrieveError,
        match=r"must have the versions .*pcretrieve \S+ instead of 0\.0\.1",
    ):
        list(DaskExecutor(scheduler_file=cluster.file)(own_process, range(3), **LIMITS))


def test_one_cluster_must_be_given() -> None:
    both = partial(DaskExecutor, "tcp://127.0.0.1:8786", Path("scheduler.json"))
    for made in (DaskExecutor, both):
        with pytest.raises(
            InputError, match="a Dask cluster must be given by the address"
        ):
            made()


@pytest.mark.slow
def test_ingest_gives_the_same_catalogue_as_on_one_computer(
    cluster: DaskCluster, tmp_path: Path
) -> None:
    paths = [tmp_path / f"egg{number}.off" for number in range(4)]
    for number, path in enumerate(paths):
        write_mesh(shapes.ellipsoid((1, 1 + number / 10, 2), subdivisions=3), path)
    paths.append(tmp_path / "flat.xyz")
    paths[-1].write_text("1 2 3\n" * 200)
    where = ("-c", tmp_path / "c.sqlite", "--scheduler-file", cluster.file, "--json")
    ended = program("ingest", *paths, *where, code=3)
    assert [row["id"] for row in json.loads(ended.stdout)["result"]["failed"]] == ["flat"]
    ingest(paths, tmp_path / "other.sqlite")
    with (
        Catalogue(tmp_path / "c.sqlite") as made,
        Catalogue(tmp_path / "other.sqlite") as expected,
    ):
        assert signatures(made) == signatures(expected)
        assert [r.message for r in made.records()] == [
            r.message for r in expected.records()
        ]
