"""A worker process, which applies a function to one item after the other, seen from its parent.

Each worker has pipes of its own, and workers do not share locks. A worker can therefore be killed at any
moment, even while it sends an answer, without an effect on other workers. What the code in a worker prints,
on standard output or standard error, goes through a third pipe and is kept with the item. Its temporary files
are in a folder that is removed with the worker.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from typing import Any, Generic, TypeVar

from pcretrieve.errors import (
    MemoryExceeded,
    PcretrieveError,
    StageTimeout,
    UnexpectedError,
    WorkerDied,
    shape_error,
)
from pcretrieve.ingestion.serving import LENGTH, serve
from pcretrieve.ingestion.temporary import TemporaryFolder

__all__ = ["Task", "Worker", "interrupts_blocked"]

Item = TypeVar("Item")
Answer = TypeVar("Answer")

CHUNK = 1 << 20  # bytes read at once

# Number of bytes that are kept of what is printed while a worker has an item: the last ones.
PRINTED = 1000

# Number of reads of the output at once: a pipe gives 64 KiB at most.
READS = 16

# Errors whose cause may be in what the code of other libraries has printed.
OF_UNKNOWN_CAUSE = (StageTimeout, WorkerDied, MemoryExceeded, UnexpectedError)

# Longest time until a worker is ready; seconds.
START_TIMEOUT = 120.0

# Longest time for each further part of an answer, after its first bytes have arrived; seconds. The worker
# waits while the parent process reads another answer.
ANSWER_TIMEOUT = 10.0

# Longest time for which a killed process is awaited; seconds. A process that waits for a disk or a network
# cannot end.
KILL_TIMEOUT = 5.0

# Longest time for which a process that has closed its pipe is awaited, before it is killed; seconds. Most
# processes close it by ending, and their own exit code says more than that of a kill.
EXIT_TIMEOUT = 2.0


@dataclass(slots=True, eq=False)
class Task(Generic[Item]):
    """An item, and the number of attempts to process it."""

    item: Item
    attempts: int = 0


class Worker(Generic[Item, Answer]):
    """A worker, in the parent process that has started it.

    deadline: time at which the task, or the start, has exceeded its limit; seconds of the monotonic clock.
    """

    def __init__(self, function: Callable[[Item], Answer], prepare: Callable[[], object]) -> None:
        # Open3D has threads, so workers must be spawned, not forked.
        context = multiprocessing.get_context("spawn")
        tasks, self._tasks = context.Pipe(duplex=False)
        self._answers, answers = context.Pipe(duplex=False)
        self._output, output = context.Pipe(duplex=False)
        for connection in (self._answers, self._output):
            os.set_blocking(connection.fileno(), False)
        self._printed = bytearray()
        self._arrived = bytearray()
        self._limit = START_TIMEOUT
        self.deadline = time.monotonic() + START_TIMEOUT
        self.task: Task[Item] | None = None
        self.n_tasks = 0
        self.is_gone = False
        self._is_at_end = False  # of the pipe of answers
        self._is_silent = False  # at the end of the pipe of output
        self._folder = TemporaryFolder()
        self._process = context.Process(
            target=serve, args=(tasks, answers, output, self._folder.path, function, prepare)
        )
        try:
            self._process.start()
        finally:
            # Only the worker has these ends open: after it has ended, reading and writing fail.
            tasks.close()
            answers.close()
            output.close()

    @property
    def events(self) -> tuple[Connection[Any, Any] | int, ...]:
        """The handles to wait for: an answer, output, and the end of the process."""
        return self._answers, self._process.sentinel, *([] if self._is_silent else [self._output])

    @property
    def printed(self) -> str:
        """The end of what was printed since the task was taken, with `` | `` between lines; often empty."""
        lines = self._printed.decode("utf-8", "replace").splitlines()
        words = ("".join(sign for sign in line if sign.isprintable()).strip() for line in lines)
        return " | ".join(word for word in words if word)

    def take(self, task: Task[Item], timeout: float) -> None:
        """Send a task to the worker, which must not have one.

        timeout: longest time for the task; seconds.
        """
        task.attempts += 1
        self.task = task
        self.n_tasks += 1
        self._printed.clear()
        self._limit = timeout
        self.deadline = time.monotonic() + timeout
        with suppress(OSError):  # the worker has ended, which `news` will report
            self._tasks.send(task.item)

    def news(self) -> tuple[Answer | PcretrieveError] | None:
        """The outcome of the task, or of the start, in a tuple; None while the worker is busy."""
        has_ended = not self._process.is_alive()
        message = self._message()
        self._listen()  # after the answer, before which the worker has printed
        if message is not None:
            try:
                outcome: Answer | PcretrieveError = pickle.loads(message)
            except Exception as error:  # noqa: BLE001  a class of a plug-in may be picklable, but not unpicklable
                outcome = shape_error(error)
            return (self._with_output(outcome) if isinstance(outcome, OF_UNKNOWN_CAUSE) else outcome,)
        if has_ended or self._is_at_end:
            self._process.join(EXIT_TIMEOUT)
            code = self.stop()
            died = WorkerDied(
                f"the process that worked on it ended with {_exit_text(code)}, perhaps for lack of memory: "
                "raise --memory if you gave it, or have fewer processes work at a time"
            )
            return (self._with_output(died),)
        if time.monotonic() >= self.deadline:
            self.stop()
            late = StageTimeout(f"not finished within {self._limit:g} s: raise --timeout")
            return (self._with_output(late),)
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
            self._listen()
            self._output.close()
            self._is_silent = True
            self._folder.remove()
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

    def _listen(self) -> None:
        """Read what has been printed, at most `CHUNK` bytes, because a worker may print without an end."""
        if self._is_silent:
            return
        with suppress(BlockingIOError):
            for _ in range(READS):
                chunk = os.read(self._output.fileno(), CHUNK // READS)
                if not chunk:
                    self._is_silent = True
                    return
                self._printed += chunk
                del self._printed[:-PRINTED]

    def _with_output(self, error: PcretrieveError) -> PcretrieveError:
        """An error, with the end of what was printed in its message."""
        if self.printed:
            error.message += f"; before this it printed: {self.printed}"
        return error


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Block the signal of Ctrl-C in the processes that are started inside, also during their imports.

    The terminal sends the signal to all processes; the parent process handles it.
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
