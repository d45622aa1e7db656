"""The application of a function to many items by worker processes, with one outcome for each item.

In come a function and items; out comes, of each item, what the function returned, or an error of pcretrieve.
Crashes of native code, endless loops and a lack of memory end the process of one item only.
"""

from __future__ import annotations

import logging
import os
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass
from functools import partial
from itertools import islice
from multiprocessing import connection
from pathlib import Path
from typing import Any, Generic, ParamSpec, Protocol, TypeVar

from pcretrieve.errors import MemoryExceeded, PcretrieveError, WorkerDied
from pcretrieve.ingestion.worker import Worker

logger = logging.getLogger(__name__)

Arguments = ParamSpec("Arguments")
Item = TypeVar("Item")
Answer = TypeVar("Answer")

# Number of items after which a worker is replaced, because cholespy does not free the workspace of its first
# solve with a factor.
MAX_ITEMS = 200

# Number of workers that may fail to start, one after the other.
MAX_FAILED_STARTS = 5

# Number of attempts for an item that lacked memory, or whose worker ended. The second attempt is in a new
# worker, because earlier items or other programs may have used the memory.
MAX_ATTEMPTS = 2


class Executor(Protocol):
    """A callable that applies a function to many items, and yields each item with its outcome."""

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
        """Apply a function to items, and yield each item with its outcome as soon as the outcome is known.

        Closing the generator cancels the work. When ``close`` returns, calls that have begun have ended, or
        their outcomes are discarded, and no further items are read.

        timeout: longest time for one item; seconds. An executor that cannot interrupt a function ignores it.
        memory: largest heap of the process of an item; GiB.
        """
        ...


@dataclass(frozen=True, slots=True)
class Isolation:
    """Calls functions in other processes, on one thread each.

    Functions, arguments and answers must be picklable. A function that imports modules when it is called
    saves the calling process these imports.

    timeout: longest time for one call; seconds.
    memory: largest heap of a process; GiB.
    """

    timeout: float = 600.0
    memory: float | None = None

    def call(
        self,
        function: Callable[Arguments, Answer],
        /,
        *arguments: Arguments.args,
        **named: Arguments.kwargs,
    ) -> Answer:
        """Call a function once."""
        ((_, outcome),) = self.each(_called, [partial(function, *arguments, **named)])
        if isinstance(outcome, PcretrieveError):
            raise outcome
        return outcome

    def each(
        self,
        function: Callable[[Item], Answer],
        items: Iterable[Item],
        *,
        workers: int = 1,
        idle: list[Worker[Item, Answer]] | None = None,
    ) -> Generator[tuple[Item, Answer | PcretrieveError], None, None]:
        """Call a function with each of many items, and yield each outcome as soon as it is known.

        What the libraries print that the function calls is not shown: its end is logged at the level INFO,
        and is in the messages of errors whose cause is unknown. Workers in `idle`, of earlier calls with the
        same function, are used first, and those that are left at the end are put there.
        """
        queue = _Queue(items)
        crew: list[Worker[Item, Answer]] = []
        failed_starts = 0
        try:
            while True:
                while len(crew) < workers and queue.holds(1 + sum(not worker.n_items for worker in crew)):
                    if idle and queue.feed(idle[-1], self.timeout):
                        crew.append(idle.pop())
                    else:
                        crew.append(Worker(function, self.memory))
                if not crew:
                    return
                first_deadline = min(worker.deadline for worker in crew)
                events = [event for worker in crew for event in worker.events]
                connection.wait(events, max(0.0, first_deadline - time.monotonic()))
                finished = []
                for worker in tuple(crew):
                    news = worker.news()
                    if news is None:
                        continue
                    if not worker.n_items:
                        failed_starts = failed_starts + 1 if worker.is_gone else 0
                        if failed_starts == MAX_FAILED_STARTS:
                            raise PcretrieveError(_no_start(worker))
                    elif not queue.takes_back(worker, *news):
                        if worker.printed:
                            logger.info("%s: its libraries printed: %s", _name(worker.item), worker.printed)
                        finished.append((worker.item, *news))
                    if worker.is_gone or not queue.feed(worker, self.timeout):
                        crew.remove(worker)
                        if idle is None or worker.is_gone or worker.n_items >= MAX_ITEMS:
                            worker.stop()
                        else:
                            idle.append(worker)
                yield from finished
        finally:
            for worker in crew:
                worker.stop()


def in_processes(
    function: Callable[[Item], Answer],
    items: Iterable[Item],
    /,
    *,
    workers: int | None,
    timeout: float,
    memory: float | None,
) -> Generator[tuple[Item, Answer | PcretrieveError], None, None]:
    """The default `Executor`: processes on this computer, by default one for each core."""
    return Isolation(timeout, memory).each(function, items, workers=workers or len(os.sched_getaffinity(0)))


class _Queue(Generic[Item]):
    """The items that no worker has taken yet, each read when a worker is ready for it."""

    def __init__(self, items: Iterable[Item]) -> None:
        self._items = iter(items)
        self._ahead: deque[Item] = deque()
        self._again: deque[tuple[Item, int]] = deque()  # with the number of the next attempt

    def holds(self, n: int) -> bool:
        """Whether there are at least `n` items for new workers."""
        self._ahead.extend(islice(self._items, max(0, n - len(self._again) - len(self._ahead))))
        return len(self._ahead) + len(self._again) >= n

    def feed(self, worker: Worker[Item, Any], timeout: float) -> bool:
        """Give a worker an item; False if the worker must be replaced, or is not needed any more."""
        if worker.n_items >= MAX_ITEMS:
            return False
        if self._again and not worker.n_items:
            item, attempt = self._again.popleft()
            worker.take(item, timeout, attempt)
            return True
        upcoming = [self._ahead.popleft()] if self._ahead else list(islice(self._items, 1))
        for item in upcoming:
            worker.take(item, timeout)
        return bool(upcoming)

    def takes_back(self, worker: Worker[Item, Any], outcome: object) -> bool:
        """Stop a worker whose item may have failed because other data were in memory, and keep the item."""
        crowded = isinstance(outcome, MemoryExceeded) and worker.n_items > 1
        if not (crowded or isinstance(outcome, WorkerDied)) or worker.attempt >= MAX_ATTEMPTS:
            return False
        worker.stop()
        self._again.append((worker.item, worker.attempt + 1))
        return True


def _no_start(worker: Worker[Any, Any]) -> str:
    return (
        f"{MAX_FAILED_STARTS} worker processes in a row ended, or hung, before they could take a shape, "
        "perhaps for lack of memory: raise --memory if you gave it, or have fewer processes work at a time"
        + (f"; the last one printed: {worker.printed}" if worker.printed else "")
    )


def _name(item: object) -> str:
    """The name of an item in the log: that of its scan, if it has or is the path of a scan."""
    path = getattr(item, "path", item)
    return path.name if isinstance(path, Path) else "a call"


def _called(task: Callable[[], Answer]) -> Answer:
    return task()
