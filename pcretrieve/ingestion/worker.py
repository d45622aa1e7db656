"""A worker process, which applies a function to one item after the other, and its handle in the parent.

Each worker has pipes of its own, and workers do not share locks. A worker can therefore be killed at any
moment, even while it sends an answer, without an effect on other workers. What the code in a worker prints,
on standard output or standard error, goes through a third pipe and is kept with the item. Its temporary files
are in a folder that is removed with the worker. The parent process holds a lock on this folder, which the
system releases when the parent ends, however that happens: a folder that is not locked belongs to nobody.
"""

from __future__ import annotations

import ctypes
import fcntl
import logging
import multiprocessing
import os
import pickle
import shutil
import signal
import struct
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Generic, TypeVar

from pcretrieve.errors import (
    MemoryExceeded,
    PcretrieveError,
    StageTimeout,
    UnexpectedError,
    WorkerDied,
    shape_error,
)

logger = logging.getLogger(__name__)

Item = TypeVar("Item")
Answer = TypeVar("Answer")

GIB = 1 << 30

# An answer is its length, followed by a pickle. The first answer only says that the worker is ready.
LENGTH = struct.Struct("<q")

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

# Beginning of the names of temporary folders, and number of attempts to make one: a folder that is not
# locked yet may be taken for that of an ended process.
PREFIX = "pcretrieve-worker-"
ATTEMPTS = 10

# <sys/prctl.h>
PR_SET_PDEATHSIG = 1

# What the kernel adds to the memory of a worker before it chooses a process to kill for lack of memory, so
# that it does not choose the parent; thousandths of all memory.
OOM_SCORE = 500


class Worker(Generic[Item, Answer]):
    """A worker, in the parent process that has started it.

    item: what the worker works on, or was given last.
    attempt: number of this attempt to process the item.
    n_items: number of items that the worker was given; 0 while it starts.
    deadline: time at which the item, or the start, has exceeded its limit; seconds of the monotonic clock.
    """

    def __init__(self, function: Callable[[Item], Answer], memory: float | None) -> None:
        # Open3D has threads, so workers must be spawned, not forked.
        context = multiprocessing.get_context("spawn")
        items, self._items = context.Pipe(duplex=False)
        self._answers, answers = context.Pipe(duplex=False)
        self._output, output = context.Pipe(duplex=False)
        for connection in (self._answers, self._output):
            os.set_blocking(connection.fileno(), False)
        self._printed = bytearray()
        self._arrived = bytearray()
        self._limit = START_TIMEOUT
        self.deadline = time.monotonic() + START_TIMEOUT
        self.item: Item
        self.attempt = self.n_items = 0
        self.is_gone = False
        self._is_at_end = False  # of the pipe of answers
        self._is_silent = False  # at the end of the pipe of output
        self._folder = TemporaryFolder()
        self._process = context.Process(
            target=_serve, args=(items, answers, output, self._folder.path, memory, function)
        )
        # The terminal sends Ctrl-C to all processes, and the parent handles it: the worker blocks it from its
        # first moment. The resource tracker, which is started with the first worker, would unblock it.
        resource_tracker.ensure_running()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        try:
            self._process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
            # Only the worker has these ends open: after it has ended, reading and writing fail.
            items.close()
            answers.close()
            output.close()

    @property
    def events(self) -> tuple[Connection[Any, Any] | int, ...]:
        """The handles to wait for: an answer, output, and the end of the process."""
        return self._answers, self._process.sentinel, *([] if self._is_silent else [self._output])

    @property
    def printed(self) -> str:
        """The end of what was printed since the item was taken, with `` | `` between lines; often empty."""
        lines = self._printed.decode("utf-8", "replace").splitlines()
        words = ("".join(sign for sign in line if sign.isprintable()).strip() for line in lines)
        return " | ".join(word for word in words if word)

    def take(self, item: Item, timeout: float, attempt: int = 1) -> None:
        """Send an item to the worker, which must not have one; `timeout` in seconds."""
        self.item, self.attempt = item, attempt
        self.n_items += 1
        self._printed.clear()
        self._limit = timeout
        self.deadline = time.monotonic() + timeout
        with suppress(OSError):  # the worker has ended, which `news` will report
            self._items.send(item)

    def news(self) -> tuple[Answer | PcretrieveError] | None:
        """The outcome of the item, or of the start, in a tuple; None while the worker is busy."""
        has_ended = not self._process.is_alive()
        message = self._message()
        self._listen()  # after the answer, before which the worker has printed
        outcome: Answer | PcretrieveError
        if message is not None:
            try:
                outcome = pickle.loads(message)
            except Exception as error:  # noqa: BLE001  a class of a plug-in may be picklable, but not unpicklable
                outcome = shape_error(error)
        elif has_ended or self._is_at_end:
            self._process.join(EXIT_TIMEOUT)
            outcome = WorkerDied(
                f"the process that worked on it ended with {_exit_text(self.stop())}, perhaps for lack of "
                "memory: raise --memory if you gave it, or have fewer processes work at a time"
            )
        elif time.monotonic() >= self.deadline:
            self.stop()
            outcome = StageTimeout(f"not finished within {self._limit:g} s: raise --timeout")
        else:
            return None
        if isinstance(outcome, OF_UNKNOWN_CAUSE) and self.printed:
            outcome.message += f"; before this it printed: {self.printed}"
        return (outcome,)

    def stop(self) -> int | None:
        """Kill the process, if it is running, and return its exit code."""
        if not self.is_gone:
            self.is_gone = True
            self._process.kill()
            self._process.join(KILL_TIMEOUT)
            self._items.close()
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


def _exit_text(code: int | None) -> str:
    """The exit code or the signal of a process as text: ``exit code 1``, ``SIGKILL``."""
    names = {-number: number.name for number in signal.Signals}
    return "no exit code" if code is None else names.get(code, f"exit code {code}")


# --- temporary files ----------------------------------------------------------------------------------


class TemporaryFolder:
    """A folder for the temporary files of one worker, in the parent process.

    The first folder of a process also removes folders that processes of the same user have left behind.
    """

    def __init__(self) -> None:
        remove_abandoned()
        self.path: str | None = None
        self._lock: int | None = None
        for _ in range(ATTEMPTS):
            try:
                path = tempfile.mkdtemp(prefix=PREFIX)
            except OSError as error:
                logger.info("workers have no temporary folder of their own: %s", error)
                return
            self._lock = _locked(Path(path))
            if self._lock is not None:
                self.path = path
                return

    def remove(self) -> None:
        """Remove the folder with all files in it."""
        if self.path is not None and self._lock is not None:
            shutil.rmtree(self.path, ignore_errors=True)
            os.close(self._lock)
            self.path = self._lock = None


@cache
def remove_abandoned() -> None:
    """Remove the folders of workers whose parent processes have ended."""
    with suppress(OSError):
        for path in Path(tempfile.gettempdir()).glob(f"{PREFIX}*"):
            lock = _locked(path)
            if lock is not None:
                shutil.rmtree(path, ignore_errors=True)
                os.close(lock)


def _locked(path: Path) -> int | None:
    """The descriptor of a folder of this user, which is locked now; None if it is gone, or locked already."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    except OSError:
        return None
    with suppress(OSError):
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.fstat(descriptor).st_uid == os.geteuid() and path.exists():
            return descriptor
    os.close(descriptor)
    return None


# --- in the worker process ----------------------------------------------------------------------------


def _serve(
    items: Connection[Any, Any],
    answers: Connection[Any, Any],
    output: Connection[Any, Any],
    folder: str | None,
    memory: float | None,
    function: Callable[[Item], Answer],
) -> None:
    """Answer items until the parent process ends: what a worker process does.

    items, answers, output: ends of the pipes; items are received, answers and what is printed are sent.
    memory: largest heap; GiB.
    """
    for standard in (1, 2):
        os.dup2(output.fileno(), standard)
    output.close()
    if not _prepare(folder, memory):
        return
    own = os.getpid()
    with suppress(EOFError, BrokenPipeError):  # the parent has ended, on a system other than Linux
        _send(answers, pickle.dumps(True))
        while True:
            item = items.recv()
            try:
                answer = pickle.dumps(function(item))
            except BaseException as error:  # noqa: BLE001  a plug-in may raise anything, also SystemExit
                answer = pickle.dumps(shape_error(error))
            _flush()
            if os.getpid() != own:
                # A child process that the function has forked, and in which the function returned too: its
                # answer would be taken for that of the next item.
                os._exit(1)
            _send(answers, answer)


def _prepare(folder: str | None, memory: float | None) -> bool:
    """Set the limits and the temporary folder of this process; False if its parent has ended already."""
    if sys.platform == "linux":
        # The kernel kills this process when its parent ends, also during a computation. Other systems let it
        # continue until it next reads from or writes to a pipe. The parent is the thread that started it.
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    parent = multiprocessing.parent_process()
    if parent is None or os.getppid() != parent.pid:
        return False
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(f"{OOM_SCORE}\n", encoding="ascii")
    if folder is not None:
        # Of Python, and of native code and child processes.
        os.environ["TMPDIR"] = tempfile.tempdir = folder
    from threadpoolctl import threadpool_limits

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threadpool_limits(limits=1)
    if memory is not None:
        import resource

        limit = int(memory * GIB)
        resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
    return True


def _flush() -> None:
    """Send what Python and C libraries have printed, and hold in memory."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(Exception):  # a plug-in may have closed or replaced it
            stream.flush()
    ctypes.CDLL(None).fflush(None)


def _send(answers: Connection[Any, Any], message: bytes) -> None:
    rest = memoryview(LENGTH.pack(len(message)) + message)
    while rest:
        rest = rest[os.write(answers.fileno(), rest) :]
