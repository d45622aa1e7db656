"""Calls of functions in other processes, whose result is an answer or an error of pcretrieve.

In come a function and its arguments; out comes what the function returned, or an error of pcretrieve. Crashes
of native code, endless loops and a lack of memory end the process of the call only.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass
from functools import partial
from typing import ParamSpec, TypeVar

from pcretrieve.errors import PcretrieveError
from pcretrieve.ingestion.worker import Worker
from pcretrieve.ingestion.workers import outcomes

__all__ = ["Isolation", "in_processes"]

GIB = 1 << 30

Arguments = ParamSpec("Arguments")
Item = TypeVar("Item")
Answer = TypeVar("Answer")


@dataclass(frozen=True, slots=True)
class Isolation:
    """Calls functions in other processes, on one thread each.

    Functions, arguments and answers must be picklable. A function that imports modules when it is called
    saves the calling process these imports.

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
            `WorkerDied`, if the process exceeded its limits, or ended without an answer.
        """
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
        """Call a function with each of many items, and return each outcome as soon as it is known.

        Parameters
        ----------
        function : callable
            A function of one item.
        items : iterable
            The items, which are read when processes are free.
        workers : int, default 1
            Largest number of processes. With one process, the outcomes are in the order of the items.
        idle : list of Worker, optional
            Processes that an earlier call with the same function has left, which are taken first; this call
            leaves its processes there. They end with the list.

        Returns
        -------
        generator of (item, outcome)
            The outcome is what the function returned, or the error that `call` would raise.
        """
        return outcomes(
            function,
            items,
            prepare=partial(_prepare, self.memory),
            workers=workers,
            timeout=self.timeout,
            idle=idle,
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
    """The default `Executor`: processes on this computer, so that items do not affect each other.

    Parameters
    ----------
    function : callable
        A function of one item.
    items : iterable
        The items, which are read when processes are free.
    workers : int, optional
        Largest number of processes. By default one for each core.
    timeout : float
        Longest time for one item; seconds.
    memory : float, optional
        Largest heap of a process; GiB. By default there is no limit.

    Returns
    -------
    generator of (item, outcome)
        The outcomes, as from `Isolation.each`.
    """
    return Isolation(timeout, memory).each(function, items, workers=workers or len(os.sched_getaffinity(0)))


def _prepare(memory: float | None) -> None:
    """Prepare a worker process: one thread, a memory limit (GiB), no Ctrl-C."""
    from threadpoolctl import threadpool_limits

    # The terminal sends Ctrl-C to all processes; the parent process handles it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threadpool_limits(limits=1)
    if memory is not None:
        import resource

        limit = int(memory * GIB)
        resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))


def _called(task: Callable[[], Answer]) -> Answer:
    return task()
