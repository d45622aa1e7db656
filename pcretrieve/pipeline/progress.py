"""Logging of stages that have ended, by the logger ``pcretrieve.pipeline``, and of compilation."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from pcretrieve.values import Step

__all__ = ["announce_compilation", "log_steps", "scan_name"]

_LOGGER = logging.getLogger("pcretrieve.pipeline")


@cache
def announce_compilation() -> None:
    """Log at the level INFO, once in a process, that numba compiles functions which it has not cached.

    The logger is ``pcretrieve.compilation``.
    """
    from numba.core import event

    class First(event.Listener):
        announced = False

        def on_start(self, event: object) -> None:
            if not self.announced:
                self.announced = True
                logging.getLogger("pcretrieve.compilation").info(
                    "compiling, once: later processes load the compiled functions from the cache of numba"
                )

        def on_end(self, event: object) -> None: ...

    event.register("numba:compile", First())  # type: ignore[no-untyped-call]


def scan_name(scan: object) -> str | None:
    """The name of a scan in messages."""
    return Path(scan).name if isinstance(scan, (str, Path)) else None


def log_steps(name: str | None, steps: Iterable[Step]) -> None:
    """Log steps: each at the level INFO, and its notes on repairs and fallbacks at the level WARNING."""
    scan = name or "scan"
    for step in steps:
        sizes = ", ".join(f"{what} {size:.6g}" for what, size in step.sizes.items())
        _LOGGER.info("%s: %s in %.2f s%s", scan, step.stage, step.seconds, f": {sizes}" if sizes else "")
        for note in step.notes:
            _LOGGER.warning("%s: %s: %s", scan, step.stage, note)
