"""The application of a function to many items by worker processes, with one outcome for each item.

Crashes of native code, endless loops and a lack of memory end the process of one item only. Each worker has
pipes of its own, and workers do not share locks. A worker can therefore be killed at any moment, even while
it sends an answer, without an effect on other workers. What the code in a worker prints goes through a second
pipe and is kept with the item. Its temporary files are in a folder that is removed with the worker, and that
the parent process has locked: a folder that is not locked belongs to nobody.
"""

from __future__ import annotations

import ctypes
import logging
import multiprocessing
import os
import pickle
import shutil
import signal
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import cache, partial
from multiprocessing import connection, resource_tracker
from multiprocessing.connection import Connection
from operator import methodcaller
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from pcretrieve.errors import (
    MemoryExceeded,
    OptionError,
    PcretrieveError,
    StageTimeout,
    UnexpectedError,
    WorkerDied,
    shape_error,
)
from pcretrieve.values.files import IS_POSIX, lock

logger = logging.getLogger(__name__)

Item = TypeVar("Item")
Answer = TypeVar("Answer")

# Number of workers that may fail to start, one after the other.
MAX_FAILED_STARTS = 5

# What a script must do that starts workers.
GUARD = 'call this below `if __name__ == "__main__":`'

# Number of attempts for an item that lacked memory, or whose worker ended. The second attempt is in a new
# worker, because earlier items or other programs may have used the memory.
MAX_ATTEMPTS = 2

GIB = 1 << 30

# Bytes that a pipe gives in one read at most, and number of reads at once: a worker may print without an end.
PIPE = 1 << 16
READS = 16

# Number of bytes that are kept of what is printed while a worker has an item: the last ones.
PRINTED = 1000

# Errors whose cause may be in what the code of other libraries has printed.
OF_UNKNOWN_CAUSE = (StageTimeout, WorkerDied, MemoryExceeded, UnexpectedError)

# Longest times; seconds. A killed process cannot end while it waits for a disk or a network; most processes
# that close their pipe do so by ending, and their own exit code says more than that of a kill.
# Until a worker is ready, which is its first answer; it may have to compile.
START_TIMEOUT = 300.0
KILL_TIMEOUT = 5.0  # until a killed process has ended
EXIT_TIMEOUT = 2.0  # until a process that has closed its pipe is killed

# Beginning of the names of temporary folders.
PREFIX = "pcretrieve-worker-"

# What the kernel adds to the memory of a worker before it chooses a process to kill for lack of memory, so
# that it does not choose the parent; thousandths of all memory.
OOM_SCORE = 500


@dataclass(frozen=True, slots=True)
class Message:
    """What a worker tells while it starts or works, before its answer."""

    content: object


# In a worker process: the pipe to its parent.
_parent: Connection[Any, Any] | None = None


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
        """Yield each item with its outcome as soon as that is known; closing the generator cancels the work.

        timeout: longest time for one item; seconds. An executor that cannot interrupt a function ignores it.
        memory: largest heap of the process of an item; GiB.
        """
        ...


def in_processes(
    function: Callable[[Item], Answer],
    items: Iterable[Item],
    /,
    *,
    workers: int | None = None,
    timeout: float = 600.0,
    memory: float | None = None,
    idle: list[Worker[Item, Answer]] | None = None,
    told: Callable[[Any], None] | None = None,
) -> Generator[tuple[Item, Answer | PcretrieveError], None, None]:
    """The default `Executor`: processes of one thread each on this computer, by default one for each core.

    Functions, items and answers must be picklable; a method ``prepare`` of a function is called before items.
    The end of what libraries print is logged, and is in the messages of errors of unknown cause.
    Workers in `idle`, of earlier calls with the same function, are used first, and those that are left at the
    end are put there. `told` is called with what the function tells by `tell` while it works.
    """
    check_main()
    if memory is not None and not IS_POSIX:
        raise OptionError(
            "this system limits the memory of no process: leave --memory out"
        )
    most = workers or n_cores()
    crew = _Crew(function, items, most, timeout, memory, idle, told)
    try:
        while crew.fill():
            yield from crew.finished()
    finally:
        crew.stop()


def own_limit(memory: float) -> float | None:
    """A limit of memory that no user gave; None where the system has no such limits. GiB."""
    return memory if IS_POSIX else None


def alone(
    function: Callable[..., Answer],
    /,
    *arguments: Any,
    timeout: float = 600.0,
    memory: float | None = None,
) -> Answer:
    """Call a function once, in a process of its own, with limits as of `in_processes`."""
    task: Callable[[partial[Answer]], Answer] = methodcaller("__call__")
    call = partial(function, *arguments)
    ((_, outcome),) = in_processes(
        task, [call], workers=1, timeout=timeout, memory=memory
    )
    if isinstance(outcome, PcretrieveError):
        raise outcome
    return outcome


def _is_tried_again(worker: Worker[Any, Any], outcome: object) -> bool:
    """Whether an item may have failed because other data were in memory, and has not been tried twice."""
    crowded = isinstance(outcome, MemoryExceeded) and worker.n_items > 1
    return (crowded or isinstance(outcome, WorkerDied)) and worker.attempt < MAX_ATTEMPTS


@cache
def _tell_once(message: str) -> None:
    """Log what each worker says while it starts."""
    logging.getLogger("pcretrieve").warning(message)


def check_main() -> None:
    """PcretrieveError in a worker that runs the script of its parent again, because it imports it."""
    # An attribute of multiprocessing, which refuses to start processes then, but not other work.
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        raise PcretrieveError(f"worker processes import the script: {GUARD}")


def _no_start(worker: Worker[Any, Any]) -> str:
    return (
        f"{MAX_FAILED_STARTS} worker processes in a row ended, or hung, before they could take a shape. In a "
        f"script, {GUARD}. Else memory may be short: raise --memory if you gave it, or have fewer processes "
        "work at a time"
        + (f"; the last one printed: {worker.printed}" if worker.printed else "")
    )


def _name(item: object) -> str:
    """The name of an item in the log: that of its scan, if it has or is the path of a scan."""
    name = getattr(getattr(item, "path", item), "name", None)
    return name if isinstance(name, str) else "a call"


class _Crew(Generic[Item, Answer]):
    """The workers of one call of `in_processes`, whose parameters these are, and what they have to do."""

    def __init__(
        self,
        function: Callable[[Item], Answer],
        items: Iterable[Item],
        most: int,
        timeout: float,
        memory: float | None,
        idle: list[Worker[Item, Answer]] | None,
        told: Callable[[Any], None] | None,
    ) -> None:
        self._started = partial(Worker, function, memory)
        self._most, self._timeout, self._idle, self._told = most, timeout, idle, told
        # Items with the number of the attempt; those that are tried again are for new workers.
        self._first = ((item, 1) for item in items)
        self._again: deque[tuple[Item, int]] = deque()
        self._workers: list[Worker[Item, Answer]] = []
        self._failed_starts = 0

    def fill(self) -> bool:
        """Give workers to items as far as there may be more; whether any worker has something to do."""
        while len(self._workers) < self._most and (
            task := self._again.popleft() if self._again else next(self._first, None)
        ):
            if self._idle and task[1] == 1:
                self._workers.append(self._idle.pop())
                self._workers[-1].take(*task, self._timeout)
            else:
                self._workers.append(self._started(*task))
        return bool(self._workers)

    def finished(self) -> list[tuple[Item, Answer | PcretrieveError]]:
        """Wait for news, and give workers that are done the next items."""
        pause = min(worker.deadline for worker in self._workers) - time.monotonic()
        events = [event for worker in self._workers for event in worker.events]
        connection.wait(events, max(0.0, pause))
        found: list[tuple[Item, Answer | PcretrieveError]] = []
        for worker in tuple(self._workers):
            if (news := worker.news()) is None:
                continue
            (outcome,) = news
            if isinstance(outcome, Message):
                hear = self._told if worker.n_items else _tell_once
                if hear is not None:
                    hear(outcome.content)
            elif not worker.n_items and not self._is_lost(worker):
                worker.take(worker.item, worker.attempt, self._timeout)
            else:
                found += self._outcome(worker, outcome)
                self._go_on(worker)
        return found

    def stop(self) -> None:
        """End all workers."""
        for worker in self._workers:
            worker.stop()

    def _is_lost(self, worker: Worker[Item, Answer]) -> bool:
        """Whether a worker has ended before it could take its first item."""
        self._failed_starts = self._failed_starts + 1 if worker.is_gone else 0
        if self._failed_starts == MAX_FAILED_STARTS:
            raise PcretrieveError(_no_start(worker))
        return worker.is_gone

    def _outcome(
        self, worker: Worker[Item, Answer], outcome: Any
    ) -> list[tuple[Item, Answer | PcretrieveError]]:
        """The item of a worker with its outcome, unless it is tried again."""
        if not worker.n_items:
            self._again.append((worker.item, worker.attempt))
            return []
        if _is_tried_again(worker, outcome):
            worker.stop()
            self._again.append((worker.item, worker.attempt + 1))
            return []
        if worker.printed:
            words = "%s: its libraries printed: %s"
            logger.info(words, _name(worker.item), worker.printed)
        return [(worker.item, outcome)]

    def _go_on(self, worker: Worker[Item, Answer]) -> None:
        """Give a worker the next item, or let it go."""
        if not worker.is_gone and (task := next(self._first, None)):
            worker.take(*task, self._timeout)
            return
        self._workers.remove(worker)
        if self._idle is None or worker.is_gone:
            worker.stop()
        else:
            self._idle.append(worker)


class Worker(Generic[Item, Answer]):
    """A worker process, in the parent that has started it.

    item: what the worker was given last; while it starts (`n_items` = 0), what it will be given first.
    deadline: time at which the item, or the start, has exceeded its limit; seconds of the monotonic clock.
    """

    def __init__(
        self,
        function: Callable[[Item], Answer],
        memory: float | None,
        item: Item,
        attempt: int,
    ) -> None:
        self.item, self.attempt, self.n_items = item, attempt, 0
        # Open3D has threads, so workers must be spawned, not forked.
        context = multiprocessing.get_context("spawn")
        self._items, items = context.Pipe()
        self._output, output = context.Pipe(duplex=False)
        if IS_POSIX:
            os.set_blocking(self._output.fileno(), False)
        self._printed = bytearray()
        self._limit = START_TIMEOUT
        self.deadline = time.monotonic() + START_TIMEOUT
        self.is_gone = False
        # At the end of the pipe of output, to which workers print on POSIX alone.
        self._is_silent = not IS_POSIX
        self._folder = TemporaryFolder()
        self._process = context.Process(
            target=_serve, args=(items, output, self._folder.path, memory, function)
        )
        try:
            with _interrupts_blocked() if IS_POSIX else nullcontext():
                self._process.start()
        finally:
            # Only the worker has these ends open: after it has ended, reading and writing fail.
            items.close()
            output.close()

    @property
    def events(self) -> tuple[Connection[Any, Any] | int, ...]:
        """The handles to wait for: an answer, output, and the end of the process."""
        return (
            self._items,
            self._process.sentinel,
            *([] if self._is_silent else [self._output]),
        )

    @property
    def printed(self) -> str:
        """The end of what was printed since the item was taken, with `` | `` between lines; often empty."""
        lines = self._printed.decode("utf-8", "replace").splitlines()
        words = (
            "".join(sign for sign in line if sign.isprintable()).strip() for line in lines
        )
        return " | ".join(word for word in words if word)

    def take(self, item: Item, attempt: int, timeout: float) -> None:
        """Send an item to the worker, which must be ready for it; `timeout` in seconds."""
        self.item, self.attempt = item, attempt
        self.n_items += 1
        self._printed.clear()
        self._limit = timeout
        self.deadline = time.monotonic() + timeout
        with suppress(OSError):  # the worker has ended, which `news` will report
            self._items.send(item)

    def news(self) -> tuple[Answer | Message | PcretrieveError] | None:
        """A message, or the outcome of the item or the start, in a tuple; None while the worker is busy."""
        has_ended = not self._process.is_alive()
        answer = None
        try:
            if self._items.poll():
                answer = self._items.recv_bytes()
        except (EOFError, OSError):
            has_ended = True
        self._listen()  # after the answer, before which the worker has printed
        outcome: Answer | Message | PcretrieveError
        if answer is not None:
            try:
                outcome = pickle.loads(answer)
            except Exception as error:  # noqa: BLE001  a class of a plug-in may be picklable, but not unpicklable
                outcome = shape_error(error)
        elif has_ended:
            self._process.join(EXIT_TIMEOUT)
            outcome = WorkerDied(
                f"the process that worked on it ended with {_exit_text(self.stop())}, perhaps for lack of "
                "memory: raise --memory if you gave it, or have fewer processes work at a time"
            )
        elif time.monotonic() >= self.deadline:
            self.stop()
            outcome = StageTimeout(
                f"not finished within {self._limit:g} s: raise --timeout"
            )
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
            self._listen()
            self._output.close()
            self._is_silent = True
            self._folder.remove()
        return self._process.exitcode

    def _listen(self) -> None:
        """Read what has been printed, without waiting for more."""
        with suppress(BlockingIOError):
            for _ in range(0 if self._is_silent else READS):
                part = os.read(self._output.fileno(), PIPE)
                self._is_silent = not part
                self._printed += part
                del self._printed[:-PRINTED]
                if not part:
                    break


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Let a worker that is started block Ctrl-C from its first moment.

    The terminal sends it to all processes, and the parent handles it.
    """
    # It is started with the first worker, and would unblock it.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def n_cores() -> int:
    """Number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _exit_text(code: int | None) -> str:
    """The exit code or the signal of a process as text: ``exit code 1``, ``SIGKILL``."""
    names = {-number: number.name for number in signal.Signals}
    return "no exit code" if code is None else names.get(code, f"exit code {code}")


# --- temporary files ----------------------------------------------------------------------------------


class TemporaryFolder:
    """A folder for the temporary files of one worker, in the parent process; none if it cannot be made.

    The first folder of a process also removes folders that processes of the same user have left behind.
    """

    def __init__(self) -> None:
        remove_abandoned()
        self.path: str | None = None
        self._lock: int | None = None
        with suppress(OSError):
            path = tempfile.mkdtemp(prefix=PREFIX)
            # Another process may take a folder that is not locked yet for that of an ended one.
            self._lock = _locked(Path(path))
            self.path = None if self._lock is None else path

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
    if not IS_POSIX:
        return None
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    except OSError:
        return None
    with suppress(OSError):
        lock(descriptor, waits=False)
        if os.fstat(descriptor).st_uid == os.geteuid() and path.exists():
            return descriptor
    os.close(descriptor)
    return None


# --- in the worker process ----------------------------------------------------------------------------


def tell(content: object) -> None:
    """Send a message to the caller of `in_processes`, before the answer; in another process, do nothing."""
    if _parent is not None:
        _parent.send(Message(content))


def _serve(
    items: Connection[Any, Any],
    output: Connection[Any, Any],
    folder: str | None,
    memory: float | None,
    function: Callable[[Item], Answer],
) -> None:
    """Answer items until the parent process ends: what a worker process does."""
    global _parent
    _parent = items
    if IS_POSIX:
        for standard in (1, 2):
            os.dup2(output.fileno(), standard)
    output.close()
    if not _prepare(folder, memory):
        return

    def passed_on(record: logging.LogRecord) -> bool:
        tell(record.getMessage())  # the parent logs it
        return False

    log = logging.getLogger("pcretrieve")
    log.addFilter(passed_on)
    try:
        getattr(function, "prepare", bool)()
    except Exception as error:
        raise SystemExit(f"{type(error).__name__}: {error}") from error
    log.removeFilter(passed_on)
    own = os.getpid()
    with suppress(
        EOFError, ConnectionError
    ):  # the parent has ended, on a system other than Linux
        items.send(True)
        while True:
            item = items.recv()
            try:
                answer = pickle.dumps(function(item))
            except BaseException as error:  # noqa: BLE001  a plug-in may raise anything, also SystemExit
                answer = pickle.dumps(shape_error(error))
            for stream in (sys.stdout, sys.stderr):
                with suppress(Exception):  # a plug-in may have closed or replaced it
                    stream.flush()
            # What C libraries have printed, and hold in memory.
            if IS_POSIX:
                ctypes.CDLL(None).fflush(None)
            if os.getpid() != own:
                # A child process that the function has forked, and in which the function returned too: its
                # answer would be taken for that of the next item.
                os._exit(1)
            items.send_bytes(answer)


def _prepare(folder: str | None, memory: float | None) -> bool:
    """Set the limits and the temporary folder of this process; False if its parent has ended already."""
    from pcretrieve.values.compiled import end_with_parent, tuned_process

    end_with_parent()
    parent = multiprocessing.parent_process()
    if parent is None or os.getppid() != parent.pid:
        return False
    with (
        suppress(OSError),
        Path("/proc/self/oom_score_adj").open("w", encoding="ascii") as file,
    ):
        file.write(f"{OOM_SCORE}\n")
    if folder is not None:
        # Of Python, and of native code and child processes.
        os.environ["TMPDIR"] = tempfile.tempdir = folder
    from threadpoolctl import threadpool_limits

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threadpool_limits(limits=1)
    tuned_process()
    if memory is not None:
        import resource

        limit = int(memory * GIB)
        resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
    return True
