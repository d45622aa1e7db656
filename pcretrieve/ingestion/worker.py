"""A worker process, seen from both ends: it applies a function to one item after the other.

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

# An answer is a pickle behind its length. The first one only says that the worker is ready.
LENGTH = struct.Struct("<q")
CHUNK = 1 << 20  # bytes read at once

# How long a worker may take to get ready; seconds.
START_TIMEOUT = 120.0

# How long each further part of an answer may take, once its first bytes have arrived; seconds. The answer
# waits in the worker while this process is busy with another one.
ANSWER_TIMEOUT = 10.0

# How long a killed process may take to be gone; seconds. One that waits for a disk or a network cannot go.
KILL_TIMEOUT = 5.0


@dataclass(slots=True, eq=False)
class Task(Generic[Item]):
    """An item, and how often a worker has taken it."""

    item: Item
    attempts: int = 0


class Worker(Generic[Item, Answer]):
    """The end of one worker that is in the process that started it.

    Parameters
    ----------
    function : callable
        Of one item.
    prepare : callable
        What the worker calls first.

    Attributes
    ----------
    task : Task or None
        What the worker works on; None while it starts.
    n_tasks : int
        Number of tasks that it has been given.
    is_gone : bool
        Whether its process has been stopped, or has ended.
    deadline : float
        When the worker is late with its task or its start; seconds of the monotonic clock.
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
            # The worker alone holds these ends: when it dies, nothing can be read or written any more.
            tasks.close()
            answers.close()

    @property
    def events(self) -> tuple[Connection[Any, Any], int]:
        """What to wait for: an answer, and the end of the process."""
        return self._answers, self._process.sentinel

    def take(self, task: Task[Item], timeout: float) -> None:
        """Hand a task to the worker, which has none.

        Parameters
        ----------
        task : Task
            What to work on.
        timeout : float
            Longest time for it; seconds.
        """
        task.attempts += 1
        self.task = task
        self.n_tasks += 1
        self._limit = timeout
        self.deadline = time.monotonic() + timeout
        with suppress(OSError):  # it is dead: `news` will say so
            self._tasks.send(task.item)

    def news(self) -> tuple[Answer | PcretrieveError] | None:
        """The outcome of the task, or of the start, in a tuple; None while the worker goes on."""
        has_ended = not self._process.is_alive()
        message = self._message()
        if message is not None:
            try:
                outcome: Answer | PcretrieveError = pickle.loads(message)
            except Exception as error:  # noqa: BLE001  a class of a plug-in's may be fit for pickling only
                outcome = shape_error(error)
            return (outcome,)
        if has_ended or self._is_at_end:
            code = self.stop()
            died = WorkerDied(
                f"the process that worked on it ended with {_exit_text(code)}, perhaps for want of memory: "
                "raise --memory if you gave it, or have fewer processes work at a time"
            )
            return (died,)
        if time.monotonic() >= self.deadline:
            self.stop()
            return (StageTimeout(f"not finished within {self._limit:g} s: raise --timeout"),)
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


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Let the processes that are started inside never see Ctrl-C, not even while they still import.

    The terminal sends it to all processes; the process that started the others decides what it means.

    Yields
    ------
    None
        Once, for the start of the processes.
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
