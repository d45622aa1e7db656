"""The application of a function to many items by worker processes, with one outcome for each item."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Sequence
from itertools import islice
from multiprocessing import connection
from pathlib import Path
from typing import Any, Generic, TypeVar

from pcretrieve.errors import PcretrieveError
from pcretrieve.ingestion.worker import Task, Worker, interrupts_blocked

__all__ = ["outcomes"]

logger = logging.getLogger(__name__)

Item = TypeVar("Item")
Answer = TypeVar("Answer")

# Number of items after which a worker is replaced, because cholespy does not free the workspace of its first
# solve with a factor. See docs/decisions.md, MAX_ITEMS.
MAX_ITEMS = 200

# Number of workers that may fail to start, one after the other.
MAX_FAILED_STARTS = 5

# Number of attempts for an item that lacked memory, or whose worker ended. The second attempt is in a new
# worker, because earlier items or other programs may have used the memory.
MAX_ATTEMPTS = 2


def outcomes(
    function: Callable[[Item], Answer],
    items: Iterable[Item],
    *,
    prepare: Callable[[], object],
    workers: int,
    timeout: float,
    idle: list[Worker[Item, Answer]] | None = None,
) -> Generator[tuple[Item, Answer | PcretrieveError], None, None]:
    """Apply a function to items, and yield each item with its outcome as soon as the outcome is known.

    What the libraries print that the function calls is not shown: its end is logged at the level INFO, and is
    in the messages of errors whose cause is unknown.

    timeout: longest time for one item; seconds.
    """
    queue = _Queue(items)
    crew: list[Worker[Item, Answer]] = []
    failed_starts = 0
    try:
        while True:
            while len(crew) < workers and queue.holds(1 + sum(worker.task is None for worker in crew)):
                if idle and (upcoming := queue.next(idle[-1])) is not None:
                    crew.append(idle.pop())
                    crew[-1].take(upcoming, timeout)
                    continue
                with interrupts_blocked():
                    crew.append(Worker(function, prepare))
            if not crew:
                return
            _wait(crew)
            finished = []
            for worker in tuple(crew):
                task, news = worker.task, worker.news()
                if news is None:
                    continue
                (outcome,) = news
                if task is None:
                    failed_starts = failed_starts + 1 if worker.is_gone else 0
                    if failed_starts == MAX_FAILED_STARTS:
                        raise PcretrieveError(
                            f"{failed_starts} worker processes in a row ended, or hung, before they could "
                            "take a shape, perhaps for lack of memory: raise --memory if you gave it, or "
                            "have fewer processes work at a time"
                            + (f"; the last one printed: {worker.printed}" if worker.printed else "")
                        )
                elif worker.has_memory_to_blame(outcome) and task.attempts < MAX_ATTEMPTS:
                    worker.stop()
                    queue.again.append(task)
                else:
                    if worker.printed:
                        logger.info("%s: its libraries printed: %s", _name(task.item), worker.printed)
                    finished.append((task.item, outcome))
                if worker.is_gone or (upcoming := queue.next(worker)) is None:
                    crew.remove(worker)
                    if idle is None or worker.is_gone or worker.n_tasks >= MAX_ITEMS:
                        worker.stop()
                    else:
                        idle.append(worker)
                else:
                    worker.take(upcoming, timeout)
            yield from finished
    finally:
        for worker in crew:
            worker.stop()


class _Queue(Generic[Item]):
    """The items that no worker has taken yet."""

    def __init__(self, items: Iterable[Item]) -> None:
        self.again: deque[Task[Item]] = deque()
        self._items = iter(items)
        self._ahead: deque[Task[Item]] = deque()

    def holds(self, n: int) -> bool:
        """Whether there are at least `n` tasks for new workers."""
        self._read(n - len(self.again))
        return len(self._ahead) + len(self.again) >= n

    def next(self, worker: Worker[Item, Any]) -> Task[Item] | None:
        """A task for a worker; None if the worker must be replaced, or is not needed any more."""
        if worker.n_tasks >= MAX_ITEMS:
            return None
        if self.again and worker.n_tasks == 0:
            return self.again.popleft()
        self._read(1)
        return self._ahead.popleft() if self._ahead else None

    def _read(self, n: int) -> None:
        missing = max(0, n - len(self._ahead))
        self._ahead.extend(Task(item) for item in islice(self._items, missing))


def _name(item: object) -> str:
    """The name of an item in the log: that of its scan, if it has or is the path of a scan."""
    path = getattr(item, "path", item)
    return path.name if isinstance(path, Path) else "a call"


def _wait(crew: Sequence[Worker[Item, Answer]]) -> None:
    """Wait until a worker has answered, has ended, or has exceeded its time limit."""
    events = [event for worker in crew for event in worker.events]
    first_deadline = min(worker.deadline for worker in crew)
    connection.wait(events, max(0.0, first_deadline - time.monotonic()))
