"""A function applied to many items by worker processes; whatever happens in one is the outcome of an item."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Sequence
from itertools import islice
from multiprocessing import connection
from typing import Any, Generic, TypeVar

from pcretrieve.errors import PcretrieveError
from pcretrieve.ingestion.worker import Task, Worker, interrupts_blocked

__all__ = ["outcomes"]

Item = TypeVar("Item")
Answer = TypeVar("Answer")

# Items after which a worker is replaced, because cholespy does not free the workspace of its first solve with
# a factor. See docs/decisions.md, MAX_ITEMS.
MAX_ITEMS = 200

# How many workers in a row may fail to get ready.
MAX_FAILED_STARTS = 5

# An item that lacked memory, or whose worker died, is tried once more in a fresh worker: earlier items may
# have left too little, or another program may have taken it.
MAX_ATTEMPTS = 2


def outcomes(
    function: Callable[[Item], Answer],
    items: Iterable[Item],
    *,
    prepare: Callable[[], object],
    workers: int,
    timeout: float,
) -> Generator[tuple[Item, Answer | PcretrieveError], None, None]:
    """Apply a function to items, and give each item with its outcome as soon as it is known.

    Parameters
    ----------
    function : callable
        The function, its argument and what it returns must be fit for pickling.
    items : iterable
        Read as workers ask for more.
    prepare : callable
        What each worker calls first.
    workers : int
        Largest number of processes at a time.
    timeout : float
        Longest time for one item; seconds.

    Yields
    ------
    item
    outcome
        What the function returned. Or what it raised, of whatever class, as an error of pcretrieve;
        `StageTimeout`; `WorkerDied`.

    Raises
    ------
    PcretrieveError
        If workers end, one after the other, before they can take an item.
    """
    queue = _Queue(items)
    crew: list[Worker[Item, Answer]] = []
    failed_starts = 0
    try:
        while True:
            while len(crew) < workers and queue.holds(1 + sum(worker.task is None for worker in crew)):
                with interrupts_blocked():
                    crew.append(Worker(function, prepare))
            if not crew:
                return
            _wait_for_news(crew)
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
                            "take a shape, perhaps for want of memory: raise --memory if you gave it, or "
                            "have fewer processes work at a time"
                        )
                elif worker.has_memory_to_blame(outcome) and task.attempts < MAX_ATTEMPTS:
                    worker.stop()
                    queue.again.append(task)
                else:
                    finished.append((task.item, outcome))
                if worker.is_gone or (upcoming := queue.next(worker)) is None:
                    crew.remove(worker)
                    worker.stop()
                else:
                    worker.take(upcoming, timeout)
            yield from finished
    finally:
        for worker in crew:
            worker.stop()


class _Queue(Generic[Item]):
    """The items that no worker has taken yet.

    Attributes
    ----------
    again : deque of Task
        Tasks that only a fresh worker may take.
    """

    def __init__(self, items: Iterable[Item]) -> None:
        self.again: deque[Task[Item]] = deque()
        self._items = iter(items)
        self._ahead: deque[Task[Item]] = deque()

    def holds(self, n: int) -> bool:
        """Whether there are as many tasks for fresh workers."""
        self._read(n - len(self.again))
        return len(self._ahead) + len(self.again) >= n

    def next(self, worker: Worker[Item, Any]) -> Task[Item] | None:
        """A task for a worker, or None where it is to make room for a fresh one, or is needed no more."""
        if worker.n_tasks >= MAX_ITEMS:
            return None
        if self.again and worker.n_tasks == 0:
            return self.again.popleft()
        self._read(1)
        return self._ahead.popleft() if self._ahead else None

    def _read(self, n: int) -> None:
        missing = max(0, n - len(self._ahead))
        self._ahead.extend(Task(item) for item in islice(self._items, missing))


def _wait_for_news(crew: Sequence[Worker[Item, Answer]]) -> None:
    """Until a worker has answered, has ended, or has had its time."""
    events = [event for worker in crew for event in worker.events]
    first_deadline = min(worker.deadline for worker in crew)
    connection.wait(events, max(0.0, first_deadline - time.monotonic()))
