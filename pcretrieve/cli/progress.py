"""How far a command is with many scans, on standard error: a bar, a line a minute, or JSON."""

from __future__ import annotations

import json
import sys
import time
from threading import Event, Thread
from types import TracebackType
from typing import TYPE_CHECKING, NoReturn

import click

from pcretrieve.cli.commands import option
from pcretrieve.cli.messages import escaped, say, without_password
from pcretrieve.cli.patience import stop_waiting

if TYPE_CHECKING:
    from tqdm import tqdm

__all__ = ["Progress", "duration", "progress_option"]

# Time between two lines where standard error is no terminal; seconds.
LINE_INTERVAL = 60.0

progress_option = option(
    "--progress",
    type=click.Choice(["bar", "json", "none"]),
    rare=True,
    default="bar",
    show_default=True,
    help="How to show progress, on standard error: a bar, or a line a minute if that is no terminal; "
    "one line of JSON for each scan; or nothing.",
)


class Progress:
    """Shows how many scans are finished, and the failures among them. A context manager."""

    def __init__(self, command: str, total: int, mode: str) -> None:
        self._command = command
        self._total = total
        self._mode = mode
        self._started = time.monotonic()
        self._n_done = 0
        self._n_failed = 0
        self._bar: tqdm[NoReturn] | None = None
        self._ended = Event()

    def __enter__(self) -> Progress:
        stop_waiting()
        if self._mode == "bar" and sys.stderr.isatty():
            from tqdm import tqdm

            self._bar = tqdm(total=self._total, unit="scan", desc=self._command)
        elif self._mode == "bar":
            say(f"{self._command}: {self._total} scans")
            Thread(target=self._say_lines, daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Show no more."""
        self._ended.set()
        if self._bar is not None:
            self._bar.close()

    def advance(self, facts: dict[str, object], failure: str | None = None) -> None:
        """Count a scan that is finished, and show it."""
        self._n_done += 1
        self._n_failed += failure is not None
        if self._mode == "json":
            counts = {"finished": self._n_done, "failures": self._n_failed, "total": self._total}
            say(json.dumps(facts | counts, ensure_ascii=False), indent=None)
        elif failure is not None and self._bar is not None:
            self._bar.write(escaped(without_password(failure)), file=sys.stderr)
        elif failure is not None:
            say(failure)
        if self._bar is not None:
            self._bar.set_postfix(failed=self._n_failed, refresh=False)
            self._bar.update()

    def _say_lines(self) -> None:
        while not self._ended.wait(LINE_INTERVAL):
            seconds = time.monotonic() - self._started
            left = "" if not self._n_done else f", {duration(seconds / self._n_done * self._n_left)} left"
            say(
                f"{self._command}: {self._n_done} of {self._total} scans, {self._n_failed} failed, after "
                f"{duration(seconds)}{left}"
            )

    @property
    def _n_left(self) -> int:
        return self._total - self._n_done


def duration(seconds: float) -> str:
    """A time in words, such as ``40 s``, ``12 min`` or ``2 h 05 min``."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes // 60} h {minutes % 60:02} min" if minutes >= 60 else f"{minutes} min"
