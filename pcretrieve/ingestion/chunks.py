"""What a Dask worker does with a chunk of scans: a child process with limits applies a function to each."""

from __future__ import annotations

import multiprocessing
import os
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from pcretrieve.errors import InputError, PcretrieveError
from pcretrieve.ingestion.isolation import Isolation
from pcretrieve.ingestion.versions import versions
from pcretrieve.ingestion.worker import Worker

__all__ = ["dismiss", "outcomes_of"]

Item = TypeVar("Item")
Answer = TypeVar("Answer")

# For each thread and ingest, the child process that waits for the next chunk; the ingests that have ended.
_IDLE: dict[tuple[int, str], list[Worker[Any, Any]]] = {}
_ENDED: set[str] = set()


def dismiss(ingest: str) -> None:
    """Stop the processes of this Dask worker that wait for chunks of an ingest, which has ended."""
    _ENDED.add(ingest)
    for key in [key for key in _IDLE if key[1] == ingest]:
        for worker in _IDLE.pop(key):
            worker.stop()


def outcomes_of(
    function: Callable[[Item], Answer],
    items: Sequence[Item],
    isolation: Isolation,
    expected: dict[str, str],
    ingest: str,
) -> tuple[list[Answer | PcretrieveError], float]:
    """Process a chunk in a child process."""
    here = versions()
    if here != expected:
        differing = ", ".join(
            f"{name} {here.get(name)} instead of {version}"
            for name, version in expected.items()
            if here.get(name) != version
        )
        raise InputError(f"a Dask worker must have the versions of the computer that writes, got {differing}")
    # The worker processes of Dask are daemons by default, which may not have child processes, because these
    # would outlive them. The processes of `Isolation` end with their parent process.
    multiprocessing.current_process().daemon = False
    # Dask has its worker processes give freed memory back at once, which would slow the child processes down
    # by a factor of 1.7: docs/decisions.md, MALLOC_TRIM_THRESHOLD_.
    os.environ.pop("MALLOC_TRIM_THRESHOLD_", None)
    started = time.monotonic()
    key = threading.get_ident(), ingest
    idle = _IDLE.pop(key, [])
    answers = [answer for _, answer in isolation.each(function, items, idle=idle)]
    if ingest not in _ENDED:
        _IDLE[key] = idle
    return answers, time.monotonic() - started
