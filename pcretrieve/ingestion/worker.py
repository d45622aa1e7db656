"""A worker process, which applies a function to one item after the other: its parent's side and its own.

Each worker has its own two pipes, and workers do not share locks. A worker can therefore be killed at any
moment, even while it sends an answer, without an effect on other workers.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from typing import Any, Generic, TypeVar

from pcretrieve.adapters.parent import end_with_parent
from pcretrieve.errors import MemoryExceeded, PcretrieveError, StageTimeout, WorkerDied, shape_error

__all__ = ["Task", "Worker", "interrupts_blocked"]

Item = TypeVar("Item")
Answer = TypeVar("Answer")

# An answer is its length, followed by a pickle. The first answer only says that the worker is ready.
LENGTH = struct.Struct("<q")
CHUNK = 1 << 20  # bytes read at once

# Longest time until a worker is ready; seconds.
START_TIMEOUT = 120.0

# Longest time for each further part of an answer, after its first bytes have arrived; seconds. The worker
# waits while the parent process reads another answer.
ANSWER_TIMEOUT = 10.0

# Longest time for which a killed process is awaited; seconds. A process that waits for a disk or a network
# cannot end.
KILL_TIMEOUT = 5.0


@dataclass(slots=True, eq=False)
class Task(Generic[Item]):
    """An item, and the number of attempts to process it."""

    item: Item
    attempts: int = 0


class Worker(Generic[Item, Answer]):
    """A worker, in the parent process that has started it.

    Parameters
    ----------
    function : callable
        A function of one item.
    prepare : callable
        A function that the worker calls first.

    Attributes
    ----------
    task : Task or None
        The present task; None until the worker is ready.
    n_tasks : int
        Number of tasks that the worker has taken.
    is_gone : bool
        Whether the process has been stopped, or has ended.
    deadline : float
        Time at which the task, or the start, has exceeded its limit; seconds of the monotonic clock.
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
        self.task: Task[Item] | None = None
        self.n_tasks = 0
        self.is_gone = False
        self._is_at_end = False  # of the pipe
        self._process = context.Process(target=_serve, args=(tasks, answers, function, prepare))
        try:
            self._process.start()
        finally:
            # Only the worker has these ends open: after it has ended, reading and writing fail.
            tasks.close()
            answers.close()

    @property
    def events(self) -> tuple[Connection[Any, Any], int]:
        """The handles to wait for: an answer, and the end of the process."""
        return self._answers, self._process.sentinel

    def take(self, task: Task[Item], timeout: float) -> None:
        """Send a task to the worker, which must not have one.

        Parameters
        ----------
        task : Task
            The task.
        timeout : float
            Longest time for the task; seconds.
        """
        task.attempts += 1
        self.task = task
        self.n_tasks += 1
        self._limit = timeout
        self.deadline = time.monotonic() + timeout
        with suppress(OSError):  # the worker has ended, which `news` will report
            self._tasks.send(task.item)

    def news(self) -> tuple[Answer | PcretrieveError] | None:
        """The outcome of the task, or of the start, in a tuple; None while the worker is busy."""
        has_ended = not self._process.is_alive()
        message = self._message()
        if message is not None:
            try:
                outcome: Answer | PcretrieveError = pickle.loads(message)
            except Exception as error:  # noqa: BLE001  a class of a plug-in may be picklable, but not unpicklable
                outcome = shape_error(error)
            return (outcome,)
        if has_ended or self._is_at_end:
            code = self.stop()
            died = WorkerDied(
                f"the process that worked on it ended with {_exit_text(code)}, perhaps for lack of memory: "
                "raise --memory if you gave it, or have fewer processes work at a time"
            )
            return (died,)
        if time.monotonic() >= self.deadline:
            self.stop()
            return (StageTimeout(f"not finished within {self._limit:g} s: raise --timeout"),)
        return None

    def has_memory_to_blame(self, outcome: object) -> bool:
        """Whether the task may have failed because other data were in memory."""
        return isinstance(outcome, WorkerDied) or (isinstance(outcome, MemoryExceeded) and self.n_tasks > 1)

    def stop(self) -> int | None:
        """Kill the process, if it is running, and return its exit code."""
        if not self.is_gone:
            self.is_gone = True
            self._process.kill()
            self._process.join(KILL_TIMEOUT)
            self._tasks.close()
            self._answers.close()
        return self._process.exitcode

    def _message(self) -> bytes | None:
        """The answer, if it is complete. Reading does not block, because a stopped worker sends nothing."""
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


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Block the signal of Ctrl-C in the processes that are started inside, also during their imports.

    The terminal sends the signal to all processes; the parent process handles it.

    Yields
    ------
    None
        Once, for the start of the processes.
    """
    # The resource tracker, which is started with the first worker, would unblock the signal.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _exit_text(code: int | None) -> str:
    """The exit code or the signal of a process as text: ``exit code 1``, ``SIGKILL``."""
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
    """Answer tasks until the parent process ends."""
    end_with_parent()
    parent = multiprocessing.parent_process()
    if parent is None or os.getppid() != parent.pid:
        return  # the parent has ended before `end_with_parent`
    prepare()
    with suppress(EOFError, BrokenPipeError):  # the parent has ended, on a system without `end_with_parent`
        _send(answers, pickle.dumps(True))
        while True:
            answer = _answer(function, tasks.recv())
            _send(answers, answer)


def _answer(function: Callable[[Item], Answer], item: Item) -> bytes:
    """What the function returned or raised, pickled. A plug-in may raise anything, also SystemExit."""
    try:
        return pickle.dumps(function(item))
    except BaseException as error:  # noqa: BLE001
        return pickle.dumps(shape_error(error))


def _send(answers: Connection[Any, Any], message: bytes) -> None:
    rest = memoryview(LENGTH.pack(len(message)) + message)
    while rest:
        rest = rest[os.write(answers.fileno(), rest) :]
