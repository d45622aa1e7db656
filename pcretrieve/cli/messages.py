"""What people read on standard error: messages, a line while they wait, and progress."""

from __future__ import annotations

import json
import logging
import os
import re
import shutil
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from threading import RLock, Timer
from typing import TYPE_CHECKING, TextIO

import click

from pcretrieve.errors import InputError

if TYPE_CHECKING:
    from rich.live import Live
    from rich.table import Table
    from rich.text import Text

    import pcretrieve as pr
    from pcretrieve.values import Failure

# What messages begin with that are red on a terminal.
WARNING_WORDS = ("Error:", "failed:")

# Characters that are printed as JSON escapes them: control characters, on which terminals act; separators of
# lines; characters that reverse the direction of the text that follows; and halves of characters. Names of
# files and classes may have any of them.
_RANGES = (
    (0x00, 0x1F),
    (0x7F, 0x9F),
    (0x2028, 0x202E),
    (0x2066, 0x2069),
    (0xD800, 0xDFFF),
)
ESCAPES = {
    code: f"\\u{code:04x}" for first, last in _RANGES for code in range(first, last + 1)
}
ESCAPES |= {
    ord(sign): escape for sign, escape in (("\n", "\\n"), ("\r", "\\r"), ("\t", "\\t"))
}

# Time until people are told what they wait for, and between two states of that line; seconds.
FIRST_WORD = 1.5
NEXT_WORD = 1.0

# Least time between two lines of progress where standard error is no terminal; seconds.
LINE_INTERVAL = 60.0

# The line at the bottom of the terminal, below which no message is printed, and the lock of both.
_bottom: list[Live] = []
_writing = RLock()

# What ends the line of waiting.
_waiting: list[ExitStack] = []


def escaped(text: str) -> str:
    """Escape the characters of a text that would change what a terminal shows around it."""
    return text.translate(ESCAPES)


def without_password(text: str) -> str:
    """Remove passwords of URLs, such as those of databases, which terminals and logs would keep."""
    return re.sub(r"(://[^/:@\s]*):[^/@\s]*@", r"\1@", text)


def shown_path(path: str) -> str:
    """A path as people read it: relative to the current folder, if it is in this folder."""
    return path.removeprefix(f"{Path.cwd()}{os.sep}")


def broken(text: str, stream: TextIO) -> str:
    """A line broken between words, as a terminal shows it; the line itself, if the stream is none."""
    width = shutil.get_terminal_size().columns
    if not stream.isatty() or len(text) <= width:
        return text
    # Paths and addresses stay whole, so that they can be copied.
    return textwrap.fill(
        text,
        width,
        break_long_words=False,
        break_on_hyphens=False,
    )


def say(message: str, *, is_broken: bool = True) -> None:
    """Print a message for users on standard error."""
    text = escaped(without_password(message))
    if is_broken:
        text = broken(text, sys.stderr)
    for word in WARNING_WORDS:
        if text.startswith(word) and not os.environ.get("NO_COLOR"):
            text = click.style(word, fg="red") + text.removeprefix(word)
    tell(text)


def tell(text: str) -> None:
    """Print text on standard error as it is; the command goes on if that cannot be written."""
    try:
        with _writing:
            if _bottom:
                from rich.text import Text

                _bottom[-1].console.print(Text.from_ansi(text), soft_wrap=True)
            else:
                click.echo(text, err=True)  # without colours, if that is no terminal
    except OSError:
        silence(sys.stderr)


def may(question: str, *, otherwise: bool) -> bool:
    """Ask people whether something may be done; `otherwise` is the answer where nobody can be asked."""
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return otherwise
    stop_waiting()
    with _writing:
        for line in _bottom:
            line.stop()
        try:
            return click.confirm(escaped(without_password(question)), err=True)
        finally:
            for line in _bottom:
                line.start()


def silence(stream: TextIO) -> None:
    """Let a standard stream that cannot be written to lead nowhere.

    Otherwise the text that waits in it would be written, and fail, once more at the end of the command.
    """
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)


def failure_line(
    name: str, failure: pr.ShapeError | pr.Record | Failure, path: str = ""
) -> str:
    """The message about a shape that failed; `path` is its file."""
    message = failure.message or ""
    file = "" if path in message else f" ({shown_path(path)})"
    shown = message.replace(path, shown_path(path)) if path else message
    return f"failed: [{name} / {failure.stage}] {shown}{file}"


# --- the log of the library ----------------------------------------------------------------------------


class Printed(logging.Handler):
    """Prints warnings of the library on standard error, except for repairs, which are in the provenance."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print one warning."""
        if record.name != "pcretrieve.pipeline":
            say(record.getMessage())


class _OneLine(logging.Formatter):
    """Formats the message of each record in one line."""

    def formatMessage(self, record: logging.LogRecord) -> str:
        return escaped(super().formatMessage(record))


class _Latest(logging.Handler):
    """Keeps the latest message of the library, such as how many shapes of how many are stored."""

    message = "at work"

    def emit(self, record: logging.LogRecord) -> None:
        self.message = record.getMessage()


@contextmanager
def _heard(handler: logging.Handler) -> Iterator[None]:
    """Let a handler hear what the library logs, from the level INFO."""
    logger = logging.getLogger("pcretrieve")
    level = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)
        handler.close()


def log_to(path: Path) -> None:
    """Append what the library logs to a file until the command ends."""
    try:
        handler = logging.FileHandler(path, encoding="utf-8")
    except OSError as error:
        raise InputError(
            f"cannot write the log file {path}: {error.strerror}; name another"
        ) from error
    handler.setFormatter(_OneLine("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    click.get_current_context().with_resource(_heard(handler))


# --- waiting and progress ------------------------------------------------------------------------------


@contextmanager
def _at_bottom(line: Callable[[], Text | Table], *, stays: bool) -> Iterator[None]:
    """Show a line at the bottom of the terminal, below messages, and leave it there at the end or not."""
    from rich.console import Console
    from rich.live import Live

    class Terminal(Console):
        def show_cursor(self, show: bool = True) -> bool:
            """Leave the cursor as it is: a process that is killed would not show it again."""
            return False

    live = Live(
        get_renderable=line,
        console=Terminal(stderr=True),
        refresh_per_second=1 / NEXT_WORD,
        transient=not stays,
        redirect_stdout=False,
        redirect_stderr=False,
    )
    with _writing:
        live.start(refresh=True)
        _bottom.append(live)
    try:
        yield
    finally:
        with _writing, suppress(OSError):  # the terminal may be closed
            _bottom.remove(live)
            live.stop()


def tell_of_waiting(command: str) -> None:
    """Show what a command does in a line of the terminal, if there is one, until `stop_waiting` is called.

    The line has the latest message of the library, and for how long the command has been at work.
    """
    if not sys.stderr.isatty():
        return
    latest, started, end = _Latest(logging.INFO), time.monotonic(), ExitStack()

    def line() -> Text:
        from rich.text import Text

        seconds = time.monotonic() - started
        words = escaped(f"{command}: {latest.message}, {seconds:.0f} s")
        return Text(words, no_wrap=True, overflow="ellipsis")

    def show() -> None:
        with _writing:
            if end in _waiting:
                end.enter_context(_at_bottom(line, stays=False))

    end.enter_context(_heard(latest))
    timer = Timer(FIRST_WORD, show)
    timer.daemon = True
    end.callback(timer.cancel)
    _waiting.append(end)
    timer.start()


def stop_waiting() -> None:
    """Show no more of it: the command shows results or progress, or has ended."""
    with _writing:
        while _waiting:
            _waiting.pop().close()


class Progress:
    """Shows how many scans are finished, and how many failed: a bar, a line a minute, or JSON."""

    def __init__(self, command: str, mode: str = "bar") -> None:
        self._command, self._mode = command, mode
        self._n_done = self._n_failed = self._total = 0
        self._end = ExitStack()
        self._started = self._said = time.monotonic()

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *error: object) -> None:
        self._end.close()

    def start(self, total: int) -> None:
        """Show that so many scans will be finished."""
        self._total = total
        stop_waiting()
        if self._mode == "bar" and sys.stderr.isatty():
            self._end.enter_context(_at_bottom(self._bar, stays=True))
        elif self._mode == "bar":
            say(f"{self._command}: {total} scans")

    def advance(self, facts: dict[str, object], failure: str | None = None) -> None:
        """Count a scan that is finished, and show it."""
        self._n_done += 1
        self._n_failed += failure is not None
        if self._mode == "json":
            counts = {
                "finished": self._n_done,
                "failures": self._n_failed,
                "total": self._total,
            }
            say(json.dumps(facts | counts, ensure_ascii=False), is_broken=False)
        elif failure is not None:
            say(failure)
        now = time.monotonic()
        is_log = self._mode == "bar" and self._total and not sys.stderr.isatty()
        if is_log and now - self._said >= LINE_INTERVAL:
            self._said = now
            say(f"{self._command}: {self._words()}")

    def _words(self) -> str:
        """How many scans are finished, after what time, and how long the others will take."""
        seconds = time.monotonic() - self._started
        words = f"{self._n_done} of {self._total} scans, {self._n_failed} failed, after {duration(seconds)}"
        if 0 < self._n_done < self._total:
            left = seconds / self._n_done * (self._total - self._n_done)
            words += f", {duration(left)} left"
        return words

    def _bar(self) -> Table:
        from rich.progress_bar import ProgressBar
        from rich.table import Column, Table

        line = Table.grid("", "", Column(no_wrap=True), padding=(0, 1))
        bar = ProgressBar(self._total, self._n_done)
        line.add_row(self._command, bar, self._words())
        return line


def duration(seconds: float) -> str:
    """A time for people, such as ``40 s``, ``12 min`` or ``2 h 05 min``."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return (
        f"{minutes // 60} h {minutes % 60:02} min" if minutes >= 60 else f"{minutes} min"
    )
