"""A function applied to many items, in processes: whatever one of them does is the outcome of an item.

Each worker has its own two pipes, and no two share a lock: a worker may be killed at any moment, even while
it sends its answer, and disturbs no other.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import struct
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from multiprocessing import connection, resource_tracker
from multiprocessing.connection import Connection
from typing import Any, Generic, TypeVar

from pcretrieve.adapters.parent import end_with_parent
from pcretrieve.errors import MemoryExceeded, PcretrieveError, StageTimeout, WorkerDied, shape_error

__all__ = ["outcomes"]

Item = TypeVar("Item")
Answer = TypeVar("Answer")

# An answer is a pickle behind its length; an empty one says that the worker is ready.
LENGTH = struct.Struct("<q")
CHUNK = 1 << 20  # bytes read at once

# Items after which a worker is replaced, because cholespy does not free the workspace of its first solve with
# a factor. See docs/decisions.md, MAX_ITEMS.
MAX_ITEMS = 200

# How long a worker may take to get ready (seconds), and how many in a row may fail to.
START_TIMEOUT = 120.0
MAX_FAILED_STARTS = 5

# How long each further part of an answer may take, once its first bytes have arrived; seconds. The answer
# waits in the worker while this process is busy with another one.
ANSWER_TIMEOUT = 10.0

# An item that lacked memory, or whose worker died, is tried once more in a fresh worker: earlier items may
# have left too little, or another program may have taken it.
MAX_ATTEMPTS = 2

# How long a killed process may take to be gone; seconds. One that waits for a disk or a network cannot go.
KILL_TIMEOUT = 5.0


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
    crew: list[_Worker[Item, Answer]] = []
    failed_starts = 0
    try:
        while True:
            while len(crew) < workers and queue.holds(1 + sum(worker.task is None for worker in crew)):
                with _interrupts_blocked():
                    crew.append(_Worker(function, prepare))
            if not crew:
                return
            _wait_for_news(crew)
            finished = []
            for worker in tuple(crew):
                task, outcome = worker.task, worker.outcome()
                if outcome is None:
                    continue
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


@dataclass(slots=True, eq=False)
class _Task(Generic[Item]):
    item: Item
    attempts: int = 0


class _Queue(Generic[Item]):
    """The items that no worker has taken yet.

    Attributes
    ----------
    again : deque of _Task
        Tasks that only a fresh worker may take.
    """

    def __init__(self, items: Iterable[Item]) -> None:
        self.again: deque[_Task[Item]] = deque()
        self._items = iter(items)
        self._ahead: deque[_Task[Item]] = deque()

    def holds(self, n: int) -> bool:
        """Whether there are as many tasks for fresh workers."""
        self._read(n - len(self.again))
        return len(self._ahead) + len(self.again) >= n

    def next(self, worker: _Worker[Item, Any]) -> _Task[Item] | None:
        """A task for a worker, or None where it is to make room for a fresh one, or is needed no more."""
        if worker.n_tasks >= MAX_ITEMS:
            return None
        if self.again and worker.n_tasks == 0:
            return self.again.popleft()
        self._read(1)
        return self._ahead.popleft() if self._ahead else None

    def _read(self, n: int) -> None:
        missing = max(0, n - len(self._ahead))
        self._ahead.extend(_Task(item) for item in islice(self._items, missing))


class _Worker(Generic[Item, Answer]):
    """The parent's end of one worker.

    Attributes
    ----------
    task : _Task or None
        What it works on; None while it starts.
    n_tasks : int
        What it has been given so far.
    is_gone : bool
    """

    def __init__(self, function: Callable[[Item], Answer], prepare: Callable[[], object]) -> None:
        # Open3D has threads, so workers must be spawned, not forked.
        context = multiprocessing.get_context("spawn")
        tasks, self._tasks = context.Pipe(duplex=False)
        self._answers, answers = context.Pipe(duplex=False)
        os.set_blocking(self._answers.fileno(), False)
        self._arrived = bytearray()
        self._limit = START_TIMEOUT
        self.deadline = time.monotonic() + START_TIMEOUT
        self.task: _Task[Item] | None = None
        self.n_tasks = 0
        self.is_gone = False
        self._is_at_end = False  # of the pipe
        self._process = context.Process(target=_serve, args=(tasks, answers, function, prepare))
        try:
            self._process.start()
        finally:
            # The worker alone holds these ends: when it dies, nothing can be read or written any more.
            tasks.close()
            answers.close()

    @property
    def events(self) -> tuple[Connection[Any, Any], int]:
        """What to wait for: an answer, and the end of the process."""
        return self._answers, self._process.sentinel

    def take(self, task: _Task[Item], timeout: float) -> None:
        """Hand a task to the worker, which has none."""
        task.attempts += 1
        self.task = task
        self.n_tasks += 1
        self._limit = timeout
        self.deadline = time.monotonic() + timeout
        with suppress(OSError):  # it is dead: `outcome` will say so
            self._tasks.send(task.item)

    def outcome(self) -> Answer | PcretrieveError | None:
        """What came of the task, or of the start; None while the worker goes on."""
        has_ended = not self._process.is_alive()
        message = self._message()
        if message is not None:
            try:
                outcome: Answer | PcretrieveError = pickle.loads(message)
            except Exception as error:  # noqa: BLE001  a class of a plug-in's may be fit for pickling only
                return shape_error(error)
            return outcome
        if has_ended or self._is_at_end:
            code = self.stop()
            return WorkerDied(
                f"the process that worked on it ended with {_exit_text(code)}, perhaps for want of memory: "
                "raise --memory if you gave it, or have fewer processes work at a time"
            )
        if time.monotonic() >= self.deadline:
            self.stop()
            return StageTimeout(f"not finished within {self._limit:g} s: raise --timeout")
        return None

    def has_memory_to_blame(self, outcome: object) -> bool:
        """Whether the task may have failed for what else was in the memory."""
        return isinstance(outcome, WorkerDied) or (isinstance(outcome, MemoryExceeded) and self.n_tasks > 1)

    def stop(self) -> int | None:
        """Kill the process, if it is there; its exit code."""
        if not self.is_gone:
            self.is_gone = True
            self._process.kill()
            self._process.join(KILL_TIMEOUT)
            self._tasks.close()
            self._answers.close()
        return self._process.exitcode

    def _message(self) -> bytes | None:
        """The whole answer, once it is here; reading never waits, because a stopped worker sends no more."""
        with suppress(BlockingIOError):
            while chunk := os.read(self._answers.fileno(), CHUNK):
                self._arrived += chunk
                self.deadline = max(self.deadline, time.monotonic() + ANSWER_TIMEOUT)
            self._is_at_end = True
        if len(self._arrived) < LENGTH.size:
            return None
        (length,) = LENGTH.unpack_from(self._arrived)
        if len(self._arrived) < LENGTH.size + length:
            return None
        message = bytes(self._arrived[LENGTH.size :])
        self._arrived.clear()
        return message


def _wait_for_news(crew: Sequence[_Worker[Item, Answer]]) -> None:
    """Until a worker has answered, has ended, or has had its time."""
    events = [event for worker in crew for event in worker.events]
    first_deadline = min(worker.deadline for worker in crew)
    connection.wait(events, max(0.0, first_deadline - time.monotonic()))


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Processes started in here never see Ctrl-C, not even while they still import.

    The terminal sends it to all of them; the process that started them decides what it means.
    """
    # The resource tracker is started with the first worker, and would lift the block.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _exit_text(code: int | None) -> str:
    """How a process ended, in words: ``exit code 1``, ``SIGKILL``."""
    if code is None:
        return "no exit code"
    names = {-number: number.name for number in signal.Signals}
    return names.get(code, f"exit code {code}")


# --- in the worker --------------------------------------------------------------------------------------


def _serve(
    tasks: Connection[Any, Any],
    answers: Connection[Any, Any],
    function: Callable[[Item], Answer],
    prepare: Callable[[], object],
) -> None:
    """Answer task after task, as long as the parent lives."""
    end_with_parent()
    parent = multiprocessing.parent_process()
    if parent is None or os.getppid() != parent.pid:
        return  # it has died before the kernel was told
    prepare()
    with suppress(EOFError, BrokenPipeError):  # it has died since, where the kernel cannot be told
        _send(answers, pickle.dumps(True))
        while True:
            answer = _answer(function, tasks.recv())
            _send(answers, answer)


def _answer(function: Callable[[Item], Answer], item: Item) -> bytes:
    """What the function returned or raised; a plug-in may raise anything, also what ends a program."""
    try:
        return pickle.dumps(function(item))
    except BaseException as error:  # noqa: BLE001
        return pickle.dumps(shape_error(error))


def _send(answers: Connection[Any, Any], message: bytes) -> None:
    rest = memoryview(LENGTH.pack(len(message)) + message)
    while rest:
        rest = rest[os.write(answers.fileno(), rest) :]
