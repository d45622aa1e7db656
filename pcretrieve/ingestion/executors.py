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
    """A callable that applies a function to many items, and yields each item with its outcome.

    ``tests/ingestion/test_executors.py`` tests that executors satisfy this protocol.
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
        """Apply a function to items, and yield each item with its outcome as soon as the outcome is known.

        Closing the generator cancels the work. When ``close`` returns, calls that have begun have ended, or
        their outcomes are discarded, and no further items are read.

        timeout: longest time for one item; seconds. An executor that cannot interrupt a function ignores it.
        """
        ...


def _checked(name: str, added: object) -> Executor:
    if not callable(added):
        raise TypeError(f"must be a callable of the protocol Executor, got {added!r}")
    executor: Executor = added
    return executor


EXECUTORS: Registry[Executor] = Registry(NAMES["executor"], {"processes": in_processes}, _checked)
