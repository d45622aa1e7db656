"""A word to the user at a terminal, while a command shows neither results nor progress."""

from __future__ import annotations

import sys
from contextlib import suppress
from threading import Event, Thread

import click

__all__ = ["stop_waiting", "tell_of_waiting"]

# Time until the first word, and between the next ones; seconds.
FIRST_WORD = 1.5
NEXT_WORD = 60.0

_stopped = Event()


def tell_of_waiting(command: str) -> None:
    """Say that a command is at work, if standard error is a terminal, until `stop_waiting` is called.

    Parameters
    ----------
    command : str
        The name of the command.
    """
    if sys.stderr.isatty():
        _stopped.clear()
        Thread(target=_tell, args=(command,), daemon=True).start()


def stop_waiting() -> None:
    """Say nothing more: the command shows results or progress, or has ended."""
    _stopped.set()


def _tell(command: str) -> None:
    words, minutes, pause = f"{command}: at work", 0, FIRST_WORD
    with suppress(OSError):  # the terminal was closed
        while not _stopped.wait(pause):
            click.echo(words, err=True)
            minutes, pause = minutes + 1, NEXT_WORD
            words = f"{command}: at work for {minutes} min"
