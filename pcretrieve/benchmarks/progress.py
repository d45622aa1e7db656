"""Progress bars on standard error."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TypeVar

from tqdm import tqdm

__all__ = ["progress"]

Thing = TypeVar("Thing")


def progress(things: Sequence[Thing], title: str) -> Iterable[Thing]:
    """Iterate with a progress bar on standard error, if that is a terminal.

    Parameters
    ----------
    things : sequence
        Any values.
    title : str
        Text of the progress bar.

    Returns
    -------
    iterable
        Over `things`.
    """
    return tqdm(things, desc=title, disable=None, leave=False)
