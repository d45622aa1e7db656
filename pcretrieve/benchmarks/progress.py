"""A count of what is done, on standard error."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TypeVar

from tqdm import tqdm

__all__ = ["progress"]

Thing = TypeVar("Thing")


def progress(things: Sequence[Thing], title: str) -> Iterable[Thing]:
    """The things one after another, counted on standard error where that is a terminal.

    Parameters
    ----------
    things : sequence
        Any values.
    title : str
        What is counted.

    Returns
    -------
    iterable
        Over `things`.
    """
    return tqdm(things, desc=title, disable=None, leave=False)
