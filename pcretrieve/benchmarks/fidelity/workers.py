"""Worker processes that take one scan at a time."""

from __future__ import annotations

import multiprocessing
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from pebble import ProcessPool
from tqdm import tqdm

from pcretrieve.benchmarks.progress import progress

__all__ = ["TIMEOUT", "ask", "workers"]

# Longest time for one scan; seconds. fTetWild with its defaults takes minutes for a fine surface.
TIMEOUT = 900.0


def workers(n: int) -> ProcessPool:
    """A pool of processes, so that a crash during one scan does not affect other scans.

    Parameters
    ----------
    n : int
        Number of processes.

    Returns
    -------
    pebble.ProcessPool
        The pool.
    """
    # Open3D has threads, so workers must be spawned, not forked.
    return ProcessPool(max_workers=n, context=multiprocessing.get_context("spawn"))


def ask(
    pool: ProcessPool, title: str, function: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]
) -> list[Any]:
    """Call a function in the workers, once for each tuple of arguments.

    Parameters
    ----------
    pool : pebble.ProcessPool
        The workers.
    title : str
        Title of messages and of the progress bar.
    function : callable
        A function of a module, so that it can be pickled.
    arguments : sequence of tuples
        Arguments of the calls.

    Returns
    -------
    list
        The results in the order of `arguments`; None for a failed call, with a message on standard error.
    """
    futures: list[Future[Any]] = [pool.schedule(function, args=given, timeout=TIMEOUT) for given in arguments]
    answers = []
    for given, future in progress(list(zip(arguments, futures, strict=True)), title):
        if error := future.exception():
            place = given[0].name if isinstance(given[0], Path) else "a mesh"
            tqdm.write(f"{title}: {place}: {type(error).__name__}: {error}", file=sys.stderr)
        answers.append(None if error else future.result())
    return answers
