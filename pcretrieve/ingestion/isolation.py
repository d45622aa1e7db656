"""Functions called in a process of their own: whatever happens there is an answer or an error.

In come a function and its arguments; out comes what it returned, or one error of pcretrieve. Native code that
crashes, an endless loop and a full memory end the process that they happen in, and no other.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass
from functools import partial
from typing import ParamSpec, TypeVar

from pcretrieve.errors import PcretrieveError
from pcretrieve.ingestion.workers import outcomes

__all__ = ["Isolation", "in_processes"]

GIB = 1 << 30

Arguments = ParamSpec("Arguments")
Item = TypeVar("Item")
Answer = TypeVar("Answer")


@dataclass(frozen=True, slots=True)
class Isolation:
    """Calls functions in processes of their own, on one thread each.

    Functions, arguments and answers must be fit for pickling. A function that imports what it needs when it
    is called spares the calling process that import.

    Attributes
    ----------
    timeout : float, default 600
        Longest time for one call; seconds.
    memory : float, optional
        Largest heap of a process; GiB.
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
        """Call a function once.

        Parameters
        ----------
        function : callable
            The function.
        *arguments, **named : object
            Arguments of the function.

        Returns
        -------
        object
            What the function returned.

        Raises
        ------
        PcretrieveError
            What the function raised, as an error of pcretrieve; `StageTimeout`, `MemoryExceeded` or
            `WorkerDied`, if the process met its limits, or ended without an answer.
        """
        ((_, outcome),) = self.each(_called, [partial(function, *arguments, **named)])
        if isinstance(outcome, PcretrieveError):
            raise outcome
        return outcome

    def each(
        self, function: Callable[[Item], Answer], items: Iterable[Item], *, workers: int = 1
    ) -> Generator[tuple[Item, Answer | PcretrieveError], None, None]:
        """Call a function on items, and give each outcome as soon as it is known.

        Parameters
        ----------
        function : callable
            Of one item.
        items : iterable
            Read as processes ask for more.
        workers : int, default 1
            Largest number of processes at a time. The outcomes of one come in the order of the items.

        Returns
        -------
        generator of (item, outcome)
            The outcome is what the function returned, or the error that `call` would raise.
        """
        return outcomes(
            function, items, prepare=partial(_prepare, self.memory), workers=workers, timeout=self.timeout
        )


def in_processes(
    function: Callable[[Item], Answer],
    items: Iterable[Item],
    /,
    *,
    workers: int | None,
    timeout: float,
    memory: float | None,
) -> Generator[tuple[Item, Answer | PcretrieveError], None, None]:
    """The `Executor` of this computer: each item in one of several processes, so that none disturbs another.

    Parameters
    ----------
    function : callable
        Of one item.
    items : iterable
        Read as processes ask for more.
    workers : int, optional
        Largest number of processes at a time. By default one for each core.
    timeout : float
        Longest time for one item; seconds.
    memory : float, optional
        Largest heap of a process; GiB. By default there is no limit.

    Returns
    -------
    generator of (item, outcome)
        As `Isolation.each` yields them.
    """
    return Isolation(timeout, memory).each(function, items, workers=workers or len(os.sched_getaffinity(0)))


def _prepare(memory: float | None) -> None:
    """Make this process a worker: one thread, a limit to its memory (GiB), deaf to Ctrl-C, silent.

    What a reader or native code prints goes to standard error: standard output is the command's.
    """
    from threadpoolctl import threadpool_limits

    os.dup2(2, 1)
    # The terminal sends Ctrl-C to every process; the one that started this one decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threadpool_limits(limits=1)
    if memory is not None:
        import resource

        limit = int(memory * GIB)
        resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))


def _called(task: Callable[[], Answer]) -> Answer:
    return task()
