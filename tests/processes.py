"""Processes that tests start."""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable, Generator, Iterable
from pathlib import Path
from typing import Any, TypeVar

import pytest

from pcretrieve.errors import PcretrieveError, shape_error

PATIENCE = 60  # seconds
MIB = 1 << 20

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
        data = item.path.file.read_bytes()  # type: ignore[attr-defined]
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
            state, _, _, its_session = (
                (process / "stat").read_text().rsplit(")", 1)[1].split()[:4]
            )
        except OSError:
            continue  # it has ended
        if int(its_session) == session and state not in "ZX":
            found.append(int(process.name))
    return found


# --- memory ----------------------------------------------------------------------------------------------

# Prints by how much a call raised the peak of the memory of its own process; MiB.
MEASURE = """
import re, sys
from contextlib import suppress
from pathlib import Path
from pcretrieve.errors import PcretrieveError
from pcretrieve.formats import ScanPath
from pcretrieve.formats.identity import content_hash
from pcretrieve.ingestion.discover import discover

def peak():
    # Not by getrusage, which begins with the peak of the process that started this one.
    return int(re.search("VmHWM:(.*) kB", Path("/proc/self/status").read_text())[1]) / 1024

if __name__ == "__main__":
    before = peak()
    with suppress(PcretrieveError):
        discover([sys.argv[1]], limits={"workers": 1, "timeout": 60, "memory": None})
    if Path(sys.argv[1]).is_file():
        with suppress(PcretrieveError):
            content_hash(ScanPath.parse(sys.argv[1]))
    print(peak() - before)
"""


def peak_of(function: Callable[[], object], error: type[Exception], words: str) -> float:
    """The largest memory of a call that is refused; MiB."""
    tracemalloc.start()
    try:
        with pytest.raises(error, match=words):
            function()
        return tracemalloc.get_traced_memory()[1] / MIB
    finally:
        tracemalloc.stop()
