"""Processes that tests start."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterable
from pathlib import Path
from typing import Any, TypeVar

from pcretrieve.errors import PcretrieveError, shape_error

PATIENCE = 60  # seconds

Item = TypeVar("Item")
Answer = TypeVar("Answer")


def in_this_process(
    function: Callable[[Item], Answer], items: Iterable[Item], /, **limits: float | None
) -> Generator[tuple[Item, Answer | PcretrieveError], None, None]:
    """The executor of tests of what is stored, which do not wait for processes to start."""
    for item in items:
        try:
            outcome: Answer | PcretrieveError = function(item)
        except Exception as error:  # noqa: BLE001  as an executor must
            outcome = shape_error(error)
        yield item, outcome


MADE: dict[bytes, Any] = {}  # what was made of a content


def remembered(
    function: Callable[[Item], Answer],
    items: Iterable[Item],
    /,
    *,
    meanwhile: Callable[[], None] = lambda: None,
    **limits: float | None,
) -> Generator[tuple[Item, Answer | PcretrieveError], None, None]:
    """The same, which computes what it makes of a content once; something else may happen meanwhile."""
    for item in items:
        data = item.path.read_bytes()  # type: ignore[attr-defined]
        if data not in MADE:
            _, MADE[data] = next(in_this_process(function, [item]))
        meanwhile()
        yield item, MADE[data]


def wait_for(condition: Callable[[], bool], seconds: float = PATIENCE) -> bool:
    """Whether a condition becomes true in time."""
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.05)
    return condition()


def living(session: int) -> list[int]:
    """The processes of a session that have not ended; those that wait to be reaped have."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            state, _, _, its_session = (process / "stat").read_text().rsplit(")", 1)[1].split()[:4]
        except OSError:
            continue  # it has ended
        if int(its_session) == session and state not in "ZX":
            found.append(int(process.name))
    return found
