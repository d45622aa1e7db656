"""Threads that read a catalogue, each by a connection of its own."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier, local
from typing import TypeVar

from pcretrieve.catalogue import Catalogue

__all__ = ["Readers"]

Answer = TypeVar("Answer")


class Readers:
    """A few threads, each with the catalogue open: a connection belongs to the thread that made it."""

    def __init__(self, location: str, n: int) -> None:
        self._location = location
        self._n = n
        self._own = local()
        self._threads = ThreadPoolExecutor(n, thread_name_prefix="pcretrieve-reader")

    async def read(self, function: Callable[[Catalogue], Answer]) -> Answer:
        """Apply a function to the catalogue in one of the threads."""
        return await asyncio.wrap_future(self._threads.submit(self._applied, function))

    def prepare(self, function: Callable[[Catalogue], object]) -> None:
        """Apply a function to the catalogue in one of the threads, without waiting for it."""
        self._threads.submit(self._applied, function)

    def close(self) -> None:
        """Close the catalogue in all threads, and end them."""
        # As many tasks as threads that wait for each other, so that each thread has one of them.
        barrier = Barrier(self._n)
        for _ in range(self._n):
            self._threads.submit(self._closed, barrier)
        self._threads.shutdown()

    def _applied(self, function: Callable[[Catalogue], Answer]) -> Answer:
        catalogue: Catalogue | None = getattr(self._own, "catalogue", None)
        if catalogue is None:
            catalogue = self._own.catalogue = Catalogue(self._location)
        return function(catalogue)

    def _closed(self, barrier: Barrier) -> None:
        barrier.wait()
        if hasattr(self._own, "catalogue"):
            self._own.catalogue.close()
