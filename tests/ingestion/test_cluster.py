"""Scans that the workers of a Dask cluster process: each has one outcome, whatever process is killed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import shapes
from dask_cluster import DaskCluster, dask_cluster

from pcretrieve import Catalogue, DaskExecutor, ingest
from pcretrieve.errors import InputError, PcretrieveError, StageTimeout, WorkerDied
from pcretrieve.formats import write_mesh
from pcretrieve.ingestion import cluster as cluster_module

pytest.importorskip("distributed", reason="distributed is not installed (the extra cluster)")

LIMITS: dict[str, Any] = {"workers": None, "timeout": 60.0, "memory": None}
PATIENCE = 120  # seconds


@pytest.fixture
def own_cluster(tmp_path: Path) -> Iterator[DaskCluster]:
    """A cluster whose processes a test may kill."""
    with dask_cluster(tmp_path / "cluster") as started:
        yield started


def square(number: int) -> int:
    return number**2


def end_process(number: int) -> int:
    if number == 3:
        os.kill(os.getpid(), signal.SIGSEGV)
    return number


def end_dask_worker(number: int) -> int:
    """Kill the Dask worker, whose child process this is."""
    if number == 3:
        os.kill(os.getppid(), signal.SIGKILL)
        time.sleep(PATIENCE)
    return number


def sleep_long(number: int) -> int:
    if number == 3:
        time.sleep(PATIENCE)
    return number


def own_process(number: int) -> int:
    return os.getpid()


def trim_threshold(number: int) -> str | None:
    return os.environ.get("MALLOC_TRIM_THRESHOLD_")


def wait_for(file: Path, number: int) -> int:
    """Wait until a file is there; leave a file that says that this item has begun."""
    file.with_suffix(f".begun{number}").touch()
    while not file.exists():
        time.sleep(0.05)
    return number


def test_a_scan_that_ends_its_process_does_not_end_the_dask_worker(cluster: DaskCluster) -> None:
    outcomes = dict(DaskExecutor(scheduler_file=cluster.file)(end_process, range(6), **LIMITS))
    assert isinstance(outcomes.pop(3), WorkerDied)
    assert outcomes == {number: number for number in (0, 1, 2, 4, 5)}
    assert all(process.poll() is None for process in cluster.workers)


def test_a_scan_has_a_time_limit(cluster: DaskCluster) -> None:
    limits = LIMITS | {"timeout": 5.0}
    outcomes = dict(DaskExecutor(scheduler_file=cluster.file)(sleep_long, range(5), **limits))
    assert isinstance(outcomes.pop(3), StageTimeout)
    assert outcomes == {number: number for number in (0, 1, 2, 4)}


def test_a_scan_that_ends_one_dask_worker_after_the_other_fails_alone(own_cluster: DaskCluster) -> None:
    """The nannies start the workers again, until the scheduler gives the chunk up."""
    outcomes = dict(DaskExecutor(scheduler_file=own_cluster.file)(end_dask_worker, range(6), **LIMITS))
    assert isinstance(outcomes.pop(3), WorkerDied)
    assert outcomes == {number: number for number in (0, 1, 2, 4, 5)}


def lose_computer(cluster: DaskCluster) -> None:
    cluster.kill(cluster.workers[0])


def lose_nanny(cluster: DaskCluster) -> None:
    """Kill the process that restarts a Dask worker, and not the Dask worker."""
    cluster.workers[0].kill()


def lose_worker(cluster: DaskCluster) -> None:
    """Kill a Dask worker, and not the process that restarts it."""
    nanny = cluster.workers[0].pid
    children = Path(f"/proc/{nanny}/task/{nanny}/children").read_text().split()
    for child in children:
        os.kill(int(child), signal.SIGKILL)


def stop_computer(cluster: DaskCluster) -> None:
    """Stop all processes of a Dask worker, which then answers no more, and keeps its connections."""
    os.killpg(cluster.workers[0].pid, signal.SIGSTOP)


@pytest.mark.parametrize("lose", [lose_computer, lose_nanny, lose_worker, stop_computer])
def test_chunks_of_a_lost_computer_are_processed_by_another_one(
    lose: Callable[[DaskCluster], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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
            deadline = time.monotonic() + PATIENCE
            while len(list(tmp_path.glob("go.begun*"))) < 2:
                assert time.monotonic() < deadline
                time.sleep(0.05)
            lose(own_cluster)
            file.touch()
            reader.join(PATIENCE)
    assert sorted(found) == [(number, number) for number in range(4)]


class Relay:
    """A process that passes the bytes of connections on, as a network does, until it is killed.

    Parameters
    ----------
    target : str
        Where to, as host:port.
    """

    def __init__(self, target: str) -> None:
        host, port = target.rsplit(":", 1)
        self._process = subprocess.Popen(
            [sys.executable, "-c", RELAY, host, port], stdout=subprocess.PIPE, text=True
        )
        assert self._process.stdout is not None
        self.address = f"tcp://127.0.0.1:{int(self._process.stdout.readline())}"

    def stop(self) -> None:
        """Cut all connections."""
        self._process.kill()

    def __enter__(self) -> Relay:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        self._process.communicate()


# Prints its port.
RELAY = """
import asyncio, sys

async def copy(source, target):
    while data := await source.read(65536):
        target.write(data)
        await target.drain()

async def relay(reader, writer):
    there, back = await asyncio.open_connection(sys.argv[1], int(sys.argv[2]))
    await asyncio.gather(copy(reader, back), copy(there, writer))

async def main():
    server = await asyncio.start_server(relay, "127.0.0.1", 0)
    print(server.sockets[0].getsockname()[1], flush=True)
    await server.serve_forever()

asyncio.run(main())
"""


def leave_a_mark(folder: Path, number: int) -> int:
    (folder / f"{number}").touch()
    return number


def test_results_that_are_lost_with_a_computer_are_computed_again(
    own_cluster: DaskCluster, tmp_path: Path
) -> None:
    """The computer ends after its chunks, and before their results were sent."""
    folder = tmp_path / "marks"
    folder.mkdir()
    executor = DaskExecutor(scheduler_file=own_cluster.file)
    with closing(executor(partial(leave_a_mark, folder), range(5), **LIMITS)) as outcomes:
        found = [next(outcomes)]
        time.sleep(2)  # the chunks that were submitted with the first one end
        own_cluster.kill(own_cluster.workers[0])
        found.extend(outcomes)
    assert sorted(found) == [(number, number) for number in range(5)]


def test_a_scheduler_that_ends_is_an_error_with_words(
    own_cluster: DaskCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster_module, "CONNECT_TIMEOUT", 5.0)
    outcomes = DaskExecutor(scheduler_file=own_cluster.file)(square, iter(range(10**9)), **LIMITS)
    next(outcomes)
    own_cluster.kill(own_cluster.scheduler)
    with pytest.raises(PcretrieveError, match="the scheduler has ended: the same command"):
        list(outcomes)


def test_a_network_that_is_gone_is_an_error_with_words(
    cluster: DaskCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster_module, "CONNECT_TIMEOUT", 5.0)
    address = json.loads(cluster.file.read_text())["address"].removeprefix("tcp://")
    with Relay(address) as relay:
        outcomes = DaskExecutor(scheduler=relay.address)(square, iter(range(10**9)), **LIMITS)
        next(outcomes)
        relay.stop()
        with pytest.raises(PcretrieveError, match="connection to the Dask scheduler was lost"):
            list(outcomes)
    # The cluster works for others.
    assert dict(DaskExecutor(scheduler_file=cluster.file)(square, range(3), **LIMITS)) == {0: 0, 1: 1, 2: 4}


def test_workers_of_other_versions_are_an_error(
    cluster: DaskCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster_module, "versions", lambda: {"pcretrieve": "0.0.1", "numpy": "1.0"})
    with pytest.raises(PcretrieveError, match=r"must have the versions .*pcretrieve \S+ instead of 0\.0\.1"):
        list(DaskExecutor(scheduler_file=cluster.file)(square, range(3), **LIMITS))


def test_chunks_grow_until_they_take_their_time(cluster: DaskCluster) -> None:
    executor = DaskExecutor(scheduler_file=cluster.file)
    numbers = iter(range(100_000))
    with closing(executor(square, numbers, **LIMITS)) as outcomes:
        next(outcomes)
        assert next(numbers) <= 4, "chunks of one item, two for each thread"
        for _ in range(10):
            next(outcomes)
        assert next(numbers) > 10


def test_processes_stay_for_the_next_chunk_and_end_with_the_ingest(cluster: DaskCluster) -> None:
    outcomes = dict(DaskExecutor(scheduler_file=cluster.file)(own_process, range(40), **LIMITS))
    numbers = {number for number in outcomes.values() if isinstance(number, int)}
    assert len(numbers) == 2, "one process for each thread of the cluster"
    deadline = time.monotonic() + PATIENCE
    while any(Path(f"/proc/{number}").exists() for number in numbers):
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_freed_memory_of_child_processes_is_not_given_back_at_once(cluster: DaskCluster) -> None:
    """Dask has it given back, which makes a scan 1.7 times as slow."""
    outcomes = dict(DaskExecutor(scheduler_file=cluster.file)(trim_threshold, range(2), **LIMITS))
    assert outcomes == {0: None, 1: None}


@pytest.mark.parametrize(
    "given",
    [{}, {"local": True, "scheduler": "tcp://127.0.0.1:8786"}, {"scheduler_file": Path("a"), "local": True}],
)
def test_one_cluster_must_be_given(given: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="must be given by one of"):
        DaskExecutor(**given)


def test_a_scheduler_that_is_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"nowhere\.json must be the file of a Dask scheduler"):
        list(DaskExecutor(scheduler_file=tmp_path / "nowhere.json")(square, [1], **LIMITS))
    monkeypatch.setattr(cluster_module, "CONNECT_TIMEOUT", 1.0)
    with pytest.raises(PcretrieveError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:9: "):
        list(DaskExecutor("tcp://127.0.0.1:9")(square, [1], **LIMITS))


# --- ingest ---------------------------------------------------------------------------------------------


def scans(folder: Path, n: int) -> list[Path]:
    folder.mkdir()
    paths = [folder / f"egg{number}.off" for number in range(n)]
    for number, path in enumerate(paths):
        write_mesh(shapes.ellipsoid((1, 1 + number / 10, 2), subdivisions=3), path)
    (folder / "flat.xyz").write_text("1 2 3\n" * 200)
    return [*paths, folder / "flat.xyz"]


def command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "pcretrieve", "ingest", *map(str, arguments)]


def test_ingest_gives_the_same_catalogue_as_on_one_computer(cluster: DaskCluster, tmp_path: Path) -> None:
    paths = scans(tmp_path / "scans", 4)
    ended = subprocess.run(
        command(*paths, "-c", tmp_path / "c.sqlite", "--scheduler-file", cluster.file, "--json"),
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 3, ended.stderr
    assert [row["id"] for row in json.loads(ended.stdout)["result"]["failed"]] == ["flat"]
    ingest(paths, tmp_path / "other.sqlite")
    with Catalogue(tmp_path / "c.sqlite") as made, Catalogue(tmp_path / "other.sqlite") as expected:
        assert made.signatures() == expected.signatures()
        assert [r.message for r in made.records()] == [r.message for r in expected.records()]


def test_a_cluster_on_this_computer_is_for_trials(tmp_path: Path) -> None:
    paths = scans(tmp_path / "scans", 1)
    arguments = (*paths, "-c", tmp_path / "c.sqlite", "--cluster", "local", "--workers", 1)
    ended = subprocess.run(command(*arguments), capture_output=True, text=True, check=False)
    assert ended.returncode == 3, ended.stderr
    assert "1 done, 1 failed" in ended.stderr


def test_ctrl_c_keeps_what_is_done(cluster: DaskCluster, tmp_path: Path) -> None:
    paths = scans(tmp_path / "scans", 40)
    arguments = (*paths, "-c", tmp_path / "c.sqlite", "--scheduler-file", cluster.file)
    with subprocess.Popen(command(*arguments), stderr=subprocess.PIPE, text=True) as running:
        deadline = time.monotonic() + PATIENCE
        n_done = 0
        while not n_done:
            assert time.monotonic() < deadline
            time.sleep(0.1)
            if (tmp_path / "c.sqlite").exists():
                with Catalogue(tmp_path / "c.sqlite") as catalogue:
                    n_done = len(catalogue)
        running.send_signal(signal.SIGINT)
        _, printed = running.communicate(timeout=PATIENCE)
    assert running.returncode == 130, printed
    assert "the same command goes on from there" in printed
    assert subprocess.run(command(*arguments), capture_output=True, check=False).returncode == 3
    with Catalogue(tmp_path / "c.sqlite") as catalogue:
        assert len(catalogue) == 40
