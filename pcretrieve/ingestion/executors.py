"""The protocol of executors, which run the work of an ingest, and the table of executors.

Another package adds an executor by an entry point of the group ``pcretrieve.executors`` that names a callable
of the protocol `Executor`; the name of the entry point is then a value of the option `--executor`.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from typing import Protocol, TypeVar

from pcretrieve.errors import PcretrieveError
from pcretrieve.ingestion.isolation import in_processes
from pcretrieve.names import NAMES
from pcretrieve.plugins import Registry

__all__ = ["EXECUTORS", "Executor"]

Item = TypeVar("Item")
Answer = TypeVar("Answer")


class Executor(Protocol):
    """A callable that applies a function to many items, and gives each item with its outcome.

    ``tests/ingestion/test_executors.py`` tests executors for what this protocol asks of them.
    """

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
        """Apply a function to items, and give each item with its outcome as soon as that is known.

        Closing the generator cancels the work: what has begun has ended, or its outcome is thrown away, when
        ``close`` returns, and no further item is read.

        Parameters
        ----------
        function : callable
            The function, its argument and what it returns can be pickled.
        items : iterable
            Must be read by the thread that iterates over the outcomes, because reading writes to the
            catalogue; and a few items at a time, as workers become free, because the files of later items are
            read then. What reading raises must be raised on.
        workers : int, optional
            Largest number of items to work on at a time. By default as many as the executor has cores.
        timeout : float
            Longest time for one item; seconds. An executor that cannot interrupt a function ignores it.
        memory : float, optional
            Largest heap of a process that works on an item; GiB. An executor without processes of its own
            ignores it.

        Yields
        ------
        item
            Each of the items once, in any order.
        outcome
            What the function returned. Or what it raised, as `pcretrieve.errors.shape_error` converts it; or
            a `StageTimeout`, a `MemoryExceeded` or a `WorkerDied`, if the item exceeded a limit or ended its
            process.

        Raises
        ------
        PcretrieveError
            If the executor cannot work at all; the ingest stops, and can be started again.
        """
        ...


def _checked(name: str, added: object) -> Executor:
    if not callable(added):
        raise TypeError(f"must be a callable of the protocol Executor, got {added!r}")
    executor: Executor = added
    return executor


EXECUTORS: Registry[Executor] = Registry(NAMES["executor"], {"processes": in_processes}, _checked)
