"""A line at a terminal that says what a command does, while it shows neither results nor a bar."""

from __future__ import annotations

import logging
import shutil
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from threading import Event, Lock, Thread

import click

__all__ = ["cleared_line", "stop_waiting", "tell_of_waiting"]

# Time until the line is shown, and between two of its states; seconds.
FIRST_WORD = 1.5
NEXT_WORD = 1.0

# Go to the beginning of the line, and clear it.
CLEAR = "\r\x1b[K"

_stopped = Event()
_writing = Lock()
_is_shown = False


class _Latest(logging.Handler):
    """Keeps the latest message of the library, such as how many shapes of how many are stored."""

    message = "at work"

    def emit(self, record: logging.LogRecord) -> None:
        self.message = record.getMessage()


def tell_of_waiting(command: str) -> None:
    """Say what a command does, if standard error is a terminal, until `stop_waiting` is called."""
    if sys.stderr.isatty():
        _stopped.clear()
        Thread(target=_tell, args=(command, _Latest(logging.INFO)), daemon=True).start()


def stop_waiting() -> None:
    """Say nothing more: the command shows results or progress, or has ended."""
    _stopped.set()
    with cleared_line():
        pass


@contextmanager
def cleared_line() -> Iterator[None]:
    """Make place for a message; the line comes back below it."""
    global _is_shown
    with _writing:
        if _is_shown:
            _is_shown = False
            with suppress(OSError):
                click.echo(CLEAR, nl=False, err=True)
        yield


def _printable(text: str) -> str:
    """A text without signs on which a terminal acts, which names of files may have."""
    return "".join(sign if sign.isprintable() else "?" for sign in text)


def _tell(command: str, latest: _Latest) -> None:
    global _is_shown
    started, pause = time.monotonic(), FIRST_WORD
    logger, level = logging.getLogger("pcretrieve"), logging.getLogger("pcretrieve").level
    logger.addHandler(latest)
    logger.setLevel(logging.INFO)
    with suppress(OSError):  # the terminal was closed
        while not _stopped.wait(pause):
            line = f"{command}: {latest.message}, {time.monotonic() - started:.0f} s"
            width = shutil.get_terminal_size().columns - 1
            with _writing:
                if not _stopped.is_set():
                    click.echo(f"{CLEAR}{_printable(line)[:width]}", nl=False, err=True)
                    _is_shown = True
            pause = NEXT_WORD
    logger.removeHandler(latest)
    logger.setLevel(level)
