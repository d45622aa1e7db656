"""Wall-clock times on one core, of functions that are called alternately."""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar

__all__ = ["Timing", "timed", "timed_by_turns", "use_one_core"]

Result = TypeVar("Result")


class Timing(NamedTuple):
    """Wall-clock times of one function.

    Attributes
    ----------
    seconds : list of float
        Time of each call.
    """

    seconds: list[float]

    @property
    def median(self) -> float:
        """Median time of a call; seconds."""
        return statistics.median(self.seconds)

    @property
    def best(self) -> float:
        """Shortest time of a call; seconds."""
        return min(self.seconds)


def timed(function: Callable[[], Result]) -> tuple[float, Result]:
    """Call a function once and take the time.

    Parameters
    ----------
    function : callable
        Without parameters.

    Returns
    -------
    seconds : float
        Wall-clock time.
    result : object
        What the function returned.
    """
    started = time.perf_counter()
    result = function()
    return time.perf_counter() - started, result


def timed_by_turns(functions: Sequence[Callable[[], Result]], n_repeats: int) -> list[tuple[Timing, Result]]:
    """Call each function in turn, `n_repeats` times over, so that other load on the machine slows all alike.

    Parameters
    ----------
    functions : sequence of callables
        Without parameters.
    n_repeats : int
        Calls of each function; at least 1.

    Returns
    -------
    list of (Timing, result)
        The times of each function, and the result of its first call.
    """
    calls = [[timed(function) for function in functions] for _ in range(n_repeats)]
    return [(Timing([seconds for seconds, _ in own]), own[0][1]) for own in zip(*calls, strict=True)]


def use_one_core() -> None:
    """Confine this process, and those that it starts, to one core, if the operating system can do so."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
