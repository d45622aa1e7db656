"""Functions of scans, called in processes of their own."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TypeVar

from tqdm import tqdm

from pcretrieve.errors import PcretrieveError
from pcretrieve.ingestion import Isolation

__all__ = ["TIMEOUT", "answers"]

Answer = TypeVar("Answer")

# Longest time for one scan; seconds. fTetWild with its defaults takes minutes for a fine surface.
TIMEOUT = 900.0


def answers(
    title: str, function: Callable[..., Answer], arguments: Sequence[tuple[object, ...]], *, workers: int
) -> list[Answer | None]:
    """Call a function once for each tuple of arguments, so that a scan that crashes takes no other with it.

    Parameters
    ----------
    title : str
        What is done, for messages and the progress bar.
    function : callable
        Of a module, so that it can be pickled.
    arguments : sequence of tuples
        Of the calls.
    workers : int
        Largest number of processes at a time.

    Returns
    -------
    list
        The results in the order of `arguments`; None for a failed call, with a message on standard error.
    """
    found: list[Answer | None] = [None] * len(arguments)
    running = Isolation(TIMEOUT).each(partial(_called, function), enumerate(arguments), workers=workers)
    with closing(running):
        for (number, given), outcome in tqdm(running, title, len(arguments), disable=None, leave=False):
            if isinstance(outcome, PcretrieveError):
                place = given[0].name if isinstance(given[0], Path) else "a mesh"
                tqdm.write(f"{title}: {place}: {type(outcome).__name__}: {outcome}", file=sys.stderr)
            else:
                found[number] = outcome
    return found


def _called(function: Callable[..., Answer], numbered: tuple[int, tuple[object, ...]]) -> Answer:
    return function(*numbered[1])
