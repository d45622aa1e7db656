"""The executor that has scans processed by the workers of a Dask cluster.

Dask distributes *chunks* of scans, which take about a minute each, so that its scheduler has thousands of
tasks for a million scans. A chunk is processed in a child process of the Dask worker, as in an ingest on one
computer, so that no scan ends or blocks the Dask worker; the child process stays for the next chunk. The
scans are read from the file system, which all computers of the cluster must share; the results are sent to
the process that has started the ingest, which alone writes the catalogue.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, Generic, TypeVar
from uuid import uuid4

from pcretrieve.errors import InputError, PcretrieveError, WorkerDied
from pcretrieve.ingestion.plan import versions
from pcretrieve.ingestion.pool import Isolation
from pcretrieve.ingestion.worker import Worker

logger = logging.getLogger(__name__)

Item = TypeVar("Item")
Answer = TypeVar("Answer")

# Time that a chunk is to take; seconds. In the first minutes of an ingest, chunks take this share of the time
# since its beginning, and at least the smallest time, so that all workers end at about the same time.
CHUNK_SECONDS = 60.0
LEAST_CHUNK_SECONDS = 2.0
CHUNK_SHARE = 0.05

# Number of chunks for each thread of the cluster: one in work, and one that waits for it.
WINDOW = 2

# Longest time to connect to the scheduler; seconds.
CONNECT_TIMEOUT = 30.0

LOST = (
    "the connection to the Dask scheduler was lost, or the scheduler has ended: the same command goes on from"
    " there when the cluster works again"
)

OTHER_VERSION = (
    "the workers of the Dask cluster must have pcretrieve, and its plug-ins, in the version of this computer"
)

# For each thread and ingest, the child process that waits for the next chunk; the ingests that have ended.
_IDLE: dict[tuple[int, str], list[Worker[Any, Any]]] = {}
_ENDED: set[str] = set()


@dataclass(frozen=True, slots=True)
class DaskExecutor:
    """An `Executor` that has items processed by the workers of a Dask cluster.

    The computers of the cluster must have the same files at the same paths, and the same versions of
    pcretrieve and of the libraries on which its results depend. One of the three attributes must be given.

    Attributes
    ----------
    scheduler : str, optional
        Address of the scheduler, such as ``tcp://host:8786``.
    scheduler_file : Path, optional
        The file with the address that ``dask scheduler --scheduler-file`` writes.
    local : bool, default False
        Whether a cluster on this computer is started, for trials: with one worker for each core, or as many
        as the argument `workers` says.
    """

    scheduler: str | None = None
    scheduler_file: Path | None = None
    local: bool = False

    def __post_init__(self) -> None:
        if sum((self.scheduler is not None, self.scheduler_file is not None, self.local)) != 1:
            raise InputError(
                "a Dask cluster must be given by one of: the address of its scheduler (--scheduler), its "
                "scheduler file (--scheduler-file), or a cluster on this computer (--cluster local)"
            )

    def __call__(
        self,
        function: Callable[[Item], Answer],
        items: Iterable[Item],
        /,
        *,
        workers: int | None,
        timeout: float,
        memory: float | None,
    ) -> Generator[tuple[Item, Answer | PcretrieveError], None, None]:
        """Apply a function to items; see `Executor`, which explains the parameters.

        `workers` limits the number of chunks in work; by default all threads of the cluster work. An item
        whose Dask worker was lost is processed again by another one; an item that was lost with several Dask
        workers, alone, has the outcome `WorkerDied`.

        Parameters
        ----------
        function, items, workers, timeout, memory : object
            As those of an `Executor`.

        Yields
        ------
        item, outcome : object
            As those of an `Executor`.

        Raises
        ------
        PcretrieveError
            If the scheduler does not answer, or its workers have other versions.
        """
        isolation = Isolation(timeout, memory)
        with _connected(self, workers) as client:
            # The number of workers of a cluster on this computer is its limit.
            most = None if self.local else workers
            yield from _Run(client, function, isolation, most).outcomes(iter(items))


class _Run(Generic[Item, Answer]):
    """The chunks of one ingest."""

    def __init__(
        self, client: Any, function: Callable[[Item], Answer], isolation: Isolation, workers: int | None
    ) -> None:
        self._client = client
        self._function = function
        self._isolation = isolation
        self._workers = workers
        self._name = uuid4().hex
        self._chunks: dict[Any, Sequence[Item]] = {}  # by future
        self._lost: deque[Item] = deque()  # items that are processed alone
        self._started = time.monotonic()
        self._n_items, self._seconds = 0, 0.0  # of the chunks that have ended

    def outcomes(self, items: Iterator[Item]) -> Iterator[tuple[Item, Answer | PcretrieveError]]:
        """Yield each item with its outcome, as soon as its chunk has ended."""
        from distributed import as_completed

        completed = as_completed([], loop=self._client.loop)
        try:
            while True:
                while len(self._chunks) < self._most_chunks() and (chunk := self._next_chunk(items)):
                    future = self._submitted(chunk)
                    self._chunks[future] = chunk
                    completed.add(future)
                if not self._chunks:
                    return
                future = next(completed)
                if future.status in ("lost", "pending"):  # its Dask worker ended before its results were sent
                    completed.add(future)
                    continue
                yield from self._ended(future, self._chunks.pop(future))
        finally:
            with suppress(Exception):  # the scheduler may have ended
                self._client.cancel(list(self._chunks))
                self._client.run(_dismiss, self._name)

    def _most_chunks(self) -> int:
        with _connection():
            n_threads = sum(self._client.nthreads().values())
        if not n_threads:
            logger.warning("the Dask cluster has no workers now: waiting for some")
        return WINDOW * max(1, n_threads) if self._workers is None else self._workers

    def _submitted(self, chunk: Sequence[Item]) -> Any:
        arguments = (self._function, chunk, self._isolation, versions(), self._name)
        with _connection():
            return self._client.submit(_outcomes_of, *arguments, pure=False)

    def _next_chunk(self, items: Iterator[Item]) -> list[Item]:
        """The items of the next chunk; none if there are no more items."""
        if self._lost:
            return [self._lost.popleft()]
        if not self._n_items:
            return list(islice(items, 1))
        share = CHUNK_SHARE * (time.monotonic() - self._started)
        seconds = min(CHUNK_SECONDS, max(LEAST_CHUNK_SECONDS, share))
        return list(islice(items, max(1, int(seconds * self._n_items / self._seconds))))

    def _ended(self, future: Any, chunk: Sequence[Item]) -> Iterator[tuple[Item, Answer | PcretrieveError]]:
        """Yield the outcomes of a chunk, or plan to process its items alone if workers were lost with it."""
        from distributed import CancelledError, KilledWorker

        try:
            results, seconds = future.result()
        except KilledWorker:
            if len(chunk) > 1:
                logger.warning(
                    "%d scans were lost with several Dask workers: each is tried alone", len(chunk)
                )
                self._lost.extend(chunk)
            else:
                yield chunk[0], WorkerDied("several Dask workers, in turn, ended while they worked on it")
        except PcretrieveError:
            raise
        except (Exception, CancelledError) as error:
            raise PcretrieveError(
                f"{OTHER_VERSION}: {type(error).__name__}: {error}" if future.status == "error" else LOST
            ) from error
        else:
            self._n_items += len(chunk)
            self._seconds += seconds
            yield from zip(chunk, results, strict=True)


@contextmanager
def _connection() -> Iterator[None]:
    """Convert the errors of a lost connection to the scheduler."""
    from distributed.client import ClosedClientError

    try:
        yield
    except (OSError, ClosedClientError) as error:
        raise PcretrieveError(LOST) from error


@contextmanager
def _connected(executor: DaskExecutor, workers: int | None) -> Iterator[Any]:
    """A client of the cluster; a cluster on this computer ends with it."""
    try:
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise InputError("Dask clusters need distributed: pip install 'pcretrieve[cluster]'") from error
    if executor.local:
        # Dask's limit of the memory would count that of child processes, which have a limit of their own.
        with (
            LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                memory_limit=0,
                dashboard_address=None,
                scheduler_kwargs={"dashboard_address": ":0"},  # any free port, for ingests at the same time
            ) as cluster,
            Client(cluster) as client,
        ):
            yield client
        return
    if executor.scheduler_file is not None and not executor.scheduler_file.is_file():
        raise InputError(f"{executor.scheduler_file} must be the file of a Dask scheduler, it is not there")
    try:
        client = Client(
            executor.scheduler,
            scheduler_file=None if executor.scheduler_file is None else str(executor.scheduler_file),
            timeout=CONNECT_TIMEOUT,
        )
    except (OSError, ValueError) as error:
        where = executor.scheduler or executor.scheduler_file
        raise PcretrieveError(f"no Dask scheduler answers at {where}: {error}") from error
    with client:
        yield client


# --- in the Dask worker -------------------------------------------------------------------------------


def _dismiss(ingest: str) -> None:
    """Stop the processes of this Dask worker that wait for chunks of an ingest, which has ended."""
    _ENDED.add(ingest)
    for key in [key for key in _IDLE if key[1] == ingest]:
        for worker in _IDLE.pop(key):
            worker.stop()


def _outcomes_of(
    function: Callable[[Item], Answer],
    items: Sequence[Item],
    isolation: Isolation,
    expected: dict[str, str],
    ingest: str,
) -> tuple[list[Answer | PcretrieveError], float]:
    """Process a chunk in a child process."""
    here = versions()
    if here != expected:
        differing = ", ".join(
            f"{name} {here.get(name)} instead of {version}"
            for name, version in expected.items()
            if here.get(name) != version
        )
        raise InputError(f"a Dask worker must have the versions of the computer that writes, got {differing}")
    # The worker processes of Dask are daemons by default, which may not have child processes, because these
    # would outlive them. The processes of `Isolation` end with their parent process.
    multiprocessing.current_process().daemon = False
    # Dask has its worker processes give freed memory back at once, which would slow the child processes down
    # by a factor of 1.7.
    os.environ.pop("MALLOC_TRIM_THRESHOLD_", None)
    started = time.monotonic()
    key = threading.get_ident(), ingest
    idle = _IDLE.pop(key, [])
    answers = [answer for _, answer in isolation.each(function, items, idle=idle)]
    if ingest not in _ENDED:
        _IDLE[key] = idle
    return answers, time.monotonic() - started
