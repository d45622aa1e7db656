"""The executor that has scans processed by the workers of a Dask cluster.

A scan is processed in a child process of the Dask worker, so that no scan ends or blocks the Dask worker; the
child process stays for the next scan. The process that has started the ingest writes the catalogue.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar
from uuid import uuid4

from pcretrieve.errors import InputError, PcretrieveError, WorkerDied
from pcretrieve.ingestion.plan import versions
from pcretrieve.ingestion.pool import Worker, in_processes

logger = logging.getLogger(__name__)

Item = TypeVar("Item")
Answer = TypeVar("Answer")

# Number of items for each thread of the cluster: one in work, and one that waits for it.
WINDOW = 2

# Longest time to connect to the scheduler; seconds.
CONNECT_TIMEOUT = 30.0

LOST = (
    "the connection to the Dask scheduler was lost, or the scheduler has ended: the same command goes on from"
    " there when the cluster works again"
)

OTHER_VERSION = (
    "the workers of the Dask cluster must have pcretrieve, and its plug-ins, in the version of this"
    " computer"
)

SEVERAL = "several Dask workers, in turn, ended while they worked on it"

# For each thread and ingest, the child process that waits for the next item; the ingests that have ended.
_IDLE: dict[tuple[int, str], list[Worker[Any, Any]]] = {}
_ENDED: set[str] = set()


@dataclass(frozen=True, slots=True)
class DaskExecutor:
    """An `Executor` that has items processed by the workers of a Dask cluster.

    The computers of the cluster must have the same files at the same paths, and the same versions of
    pcretrieve and of the libraries on which its results depend. One of both attributes must be given.

    Attributes
    ----------
    scheduler : str, optional
        Address of the scheduler, such as ``tcp://host:8786``.
    scheduler_file : Path, optional
        The file with the address that ``dask scheduler --scheduler-file`` writes.
    """

    scheduler: str | None = None
    scheduler_file: Path | None = None

    def __post_init__(self) -> None:
        if (self.scheduler is None) == (self.scheduler_file is None):
            raise InputError(
                "a Dask cluster must be given by the address of its scheduler (--scheduler), or by its "
                "scheduler file (--scheduler-file)"
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
        """Apply a function to items, as every `Executor`; `workers` limits the number of items in work.

        An item that was lost with several Dask workers is tried again at the end, alone. PcretrieveError is
        raised if the scheduler does not answer, or its workers have other versions.
        """
        rest, given_up = iter(items), deque[Item]()
        # By future, with whether it is the only one.
        running: dict[Any, tuple[Item, bool]] = {}
        with _connected(self) as client:
            from distributed import as_completed

            ingest = uuid4().hex
            call = partial(_outcome_of, function, timeout, memory, versions(), ingest)
            completed = as_completed([], loop=client.loop)

            def submit(item: Item, is_alone: bool) -> None:
                with _connection():
                    future = client.submit(call, item, pure=False)
                running[future] = item, is_alone
                completed.add(future)

            try:
                while True:
                    most = _window(client) if workers is None else workers
                    for item in islice(rest, max(0, most - len(running))):
                        submit(item, False)
                    if not running and given_up:
                        submit(given_up.popleft(), True)
                    if not running:
                        return
                    future = next(completed)
                    if future.status in (
                        "lost",
                        "pending",
                    ):  # its worker ended before its answer was sent
                        completed.add(future)
                        continue
                    item, is_alone = running.pop(future)
                    outcome = _result_of(future)
                    if (
                        isinstance(outcome, WorkerDied)
                        and not is_alone
                        and outcome.message == SEVERAL
                    ):
                        logger.warning(
                            "a scan was lost with several Dask workers: it is tried alone"
                        )
                        given_up.append(item)
                    else:
                        yield item, outcome
            finally:
                with suppress(Exception):  # the scheduler may have ended
                    client.cancel(list(running))
                    client.run(_dismiss, ingest)


def _window(client: Any) -> int:
    """Number of items that are submitted at a time, to a cluster that may grow and shrink."""
    with _connection():
        n_threads: int = sum(client.nthreads().values())
    if not n_threads:
        logger.warning("the Dask cluster has no workers now: waiting for some")
    return WINDOW * max(1, n_threads)


def _result_of(future: Any) -> Any:
    """The outcome of an item whose computation has ended."""
    from distributed import CancelledError, KilledWorker

    try:
        return future.result()
    except KilledWorker:
        return WorkerDied(SEVERAL)
    except PcretrieveError:
        raise
    except (Exception, CancelledError) as error:
        raise PcretrieveError(
            f"{OTHER_VERSION}: {type(error).__name__}: {error}"
            if future.status == "error"
            else LOST
        ) from error


@contextmanager
def _connection() -> Iterator[None]:
    """Convert the errors of a lost connection to the scheduler."""
    from distributed.client import ClosedClientError

    try:
        yield
    except (OSError, ClosedClientError) as error:
        raise PcretrieveError(LOST) from error


@contextmanager
def _connected(executor: DaskExecutor) -> Iterator[Any]:
    """A client of the cluster."""
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError(
            "Dask clusters need distributed: pip install 'pcretrieve[cluster]'"
        ) from error
    if executor.scheduler_file is not None and not executor.scheduler_file.is_file():
        raise InputError(
            f"{executor.scheduler_file} must be the file of a Dask scheduler, it is not there"
        )
    file = None if executor.scheduler_file is None else str(executor.scheduler_file)
    with _forwarding():
        try:
            client = Client(
                executor.scheduler, scheduler_file=file, timeout=CONNECT_TIMEOUT
            )
        # An address, or a file, that is none of a scheduler raises all kinds of errors.
        except Exception as error:
            raise PcretrieveError(
                f"no Dask scheduler answers at {executor.scheduler or file}: "
                f"{str(error) or type(error).__name__}"
            ) from error
        with client:
            yield client


@contextmanager
def _forwarding() -> Iterator[None]:
    """Keep what Dask prints, such as tracebacks, for the log: the error that follows has the right words."""
    handlers = logging.getLogger("distributed").handlers
    for handler in handlers:
        handler.addFilter(_forwarded)
    try:
        yield
    finally:
        for handler in handlers:
            handler.removeFilter(_forwarded)


def _forwarded(record: logging.LogRecord) -> bool:
    """Log a message of Dask below the warnings that people see; false, so that it is not printed."""
    logger.info("%s: %s", record.name, record.getMessage())
    return False


# --- in the Dask worker -------------------------------------------------------------------------------


def _dismiss(ingest: str) -> None:
    """Stop the processes of this Dask worker that wait for items of an ingest, which has ended."""
    _ENDED.add(ingest)
    for key in [key for key in _IDLE if key[1] == ingest]:
        for worker in _IDLE.pop(key):
            worker.stop()


def _outcome_of(
    function: Callable[[Item], Answer],
    timeout: float,
    memory: float | None,
    expected: dict[str, str],
    ingest: str,
    item: Item,
) -> Answer | PcretrieveError:
    """Process an item in a child process."""
    here = versions()
    if here != expected:
        differing = ", ".join(
            f"{name} {here.get(name)} instead of {version}"
            for name, version in expected.items()
            if here.get(name) != version
        )
        raise InputError(
            f"a Dask worker must have the versions of the computer that writes, got {differing}"
        )
    # The worker processes of Dask are daemons by default, which may not have child processes, because these
    # would outlive them. The processes of `in_processes` end with their parent process.
    multiprocessing.current_process().daemon = False
    # Dask has its worker processes give freed memory back at once, which would slow the child processes down
    # by a factor of 1.7.
    os.environ.pop("MALLOC_TRIM_THRESHOLD_", None)
    key = threading.get_ident(), ingest
    idle = _IDLE.pop(key, [])
    limits: dict[str, Any] = {"timeout": timeout, "memory": memory}
    ((_, outcome),) = in_processes(function, [item], workers=1, idle=idle, **limits)
    if ingest not in _ENDED:
        _IDLE[key] = idle
    return outcome
