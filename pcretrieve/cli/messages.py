"""What commands print: messages for users on standard error, results for programs on standard output."""

from __future__ import annotations

import logging
import os
import re
import shutil
import sys
import textwrap
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

import click

from pcretrieve.cli.patience import cleared_line, stop_waiting
from pcretrieve.errors import InputError

if TYPE_CHECKING:
    from pcretrieve.catalogue import Record

__all__ = [
    "ESCAPES_IN_JSON",
    "escaped",
    "failure_line",
    "log_to",
    "print_text",
    "say",
    "shown_path",
    "silence",
    "without_password",
    "write_csv",
    "write_line",
    "write_row",
    "write_words",
]

# What messages begin with that are red on a terminal.
WARNING_WORDS = ("Error:", "failed:")

# Characters that are printed as JSON escapes them: control characters, on which terminals act; separators of
# lines; characters that reverse the direction of the text that follows; and halves of characters. Names of
# files and classes may have any of them.
ESCAPES = {
    code: f"\\u{code:04x}"
    for first, last in (
        (0x00, 0x1F),
        (0x7F, 0x9F),
        (0x2028, 0x202E),
        (0x2066, 0x2069),
        (0xD800, 0xDFFF),
    )
    for code in range(first, last + 1)
} | {ord(sign): escape for sign, escape in (("\n", "\\n"), ("\r", "\\r"), ("\t", "\\t"))}

#: A JSON document has escaped those in its strings; others are between its values.
ESCAPES_IN_JSON = {code: escape for code, escape in ESCAPES.items() if code != ord("\n")}


def escaped(text: str) -> str:
    """Escape the characters of a text that would change what a terminal shows around it."""
    return text.translate(ESCAPES)


def say(message: str, *, indent: int | None = 0) -> None:
    """Print a message for users on standard error; the command goes on if that cannot be written."""
    text = escaped(without_password(message))
    if indent is not None:
        text = _broken(text, sys.stderr, indent)
    for word in WARNING_WORDS:
        if text.startswith(word) and not os.environ.get("NO_COLOR"):
            text = click.style(word, fg="red") + text.removeprefix(word)
    try:
        with cleared_line():
            click.echo(text, err=True)  # without colours, if that is no terminal
    except OSError:
        silence(sys.stderr)


def without_password(text: str) -> str:
    """Remove passwords of URLs, such as those of databases, which terminals and logs would keep."""
    return re.sub(r"(://[^/:@\s]*):[^/@\s]*@", r"\1@", text)


def silence(stream: TextIO) -> None:
    """Let a standard stream that cannot be written to lead nowhere.

    Otherwise the text that it holds would be written, and fail, once more at the end of the command.
    """
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)


def write_line(text: str) -> None:
    """Print a line of a result, on standard output."""
    print_text(escaped(text))


def write_words(text: str) -> None:
    """Print a sentence of a result, on standard output; on a terminal, broken between words."""
    print_text(_broken(escaped(without_password(text)), sys.stdout))


def _broken(text: str, stream: TextIO, indent: int = 0) -> str:
    """A line as a terminal shows it, or the line itself, if the stream is none."""
    width = shutil.get_terminal_size().columns
    if not stream.isatty() or len(text) <= width:
        return text
    # Paths and addresses stay whole, so that they can be copied.
    return textwrap.fill(
        text, width, subsequent_indent=" " * indent, break_long_words=False, break_on_hyphens=False
    )


def write_row(cells: Iterable[str]) -> None:
    """Print a row of a result, on standard output."""
    print_text("\t".join(map(escaped, cells)))


def log_to(path: Path) -> None:
    """Append what the library logs, from the level INFO, to a file until the command ends."""
    try:
        handler = logging.FileHandler(path, encoding="utf-8")
    except OSError as error:
        raise InputError(f"cannot write the log file {path}: {error.strerror}; name another") from error
    handler.setFormatter(_OneLine("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    logger, level = logging.getLogger("pcretrieve"), logging.getLogger("pcretrieve").level
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)

    def stop() -> None:
        logger.removeHandler(handler)
        logger.setLevel(level)
        handler.close()

    click.get_current_context().call_on_close(stop)


class _OneLine(logging.Formatter):
    """Formats the message of each record in one line."""

    def formatMessage(self, record: logging.LogRecord) -> str:
        return escaped(super().formatMessage(record))


def print_text(text: str, *, nl: bool = True, color: bool | None = None) -> None:
    """Print the text of a result, on standard output."""
    stop_waiting()
    click.echo(text, nl=nl, color=color)


def shown_path(path: str) -> str:
    """A path as people read it: relative to the current folder, if it is in this folder."""
    return path.removeprefix(f"{Path.cwd()}{os.sep}")


def failure_line(record: Record) -> str:
    """The message about a shape that failed."""
    message, path = record.message or "", shown_path(record.path)
    file = "" if record.path in message else f" ({path})"
    return f"failed: [{record.id} / {record.stage}] {message.replace(record.path, path)}{file}"


def write_csv(text: str) -> None:
    """Print the text of a CSV file on standard output: as it is for a program, escaped for a terminal."""
    shown = text.translate(ESCAPES_IN_JSON) if sys.stdout.isatty() else text
    print_text(shown, nl=False, color=True)  # otherwise click removes what looks like codes of a terminal
