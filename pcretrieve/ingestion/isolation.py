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

    timeout: longest time for one call; seconds.
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
        """Call a function once."""
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

        Returns generator of (item, outcome): the outcome is what the function returned, or the error that
            `call` would raise.
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

    timeout: longest time for one item; seconds.
    Returns generator of (item, outcome): the outcomes, as from `Isolation.each`.
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
