"""What commands print: messages for users on standard error, results for programs on standard output."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterable
from pathlib import Path
from textwrap import indent
from typing import TYPE_CHECKING

import click

from pcretrieve.errors import InputError

if TYPE_CHECKING:
    from pcretrieve.catalogue import Record
    from pcretrieve.types import Step

__all__ = ["failure_line", "log_to", "say", "step_lines", "write_json", "write_json_list"]


def say(message: str) -> None:
    """Print a message for users, on standard error.

    Parameters
    ----------
    message : str
        The message.
    """
    click.echo(message, err=True)


def log_to(path: Path) -> None:
    """Append what the library logs, from the level INFO, to a file until the command ends.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    try:
        handler = logging.FileHandler(path, encoding="utf-8")
    except OSError as error:
        raise InputError(f"cannot write the log file {path}: {error.strerror}; name another") from error
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    logger, level = logging.getLogger("pcretrieve"), logging.getLogger("pcretrieve").level
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)

    def stop() -> None:
        logger.removeHandler(handler)
        logger.setLevel(level)
        handler.close()

    click.get_current_context().call_on_close(stop)


def write_json(document: object) -> None:
    """Print a JSON document for programs, on standard output.

    Parameters
    ----------
    document : object
        What JSON can represent.
    """
    click.echo(json.dumps(document, indent=2, ensure_ascii=False))


def write_json_list(documents: Iterable[object]) -> None:
    """Print a list as a JSON document on standard output, each element as soon as it is computed.

    Parameters
    ----------
    documents : iterable of object
        What JSON can represent.
    """
    before = "["
    for document in documents:
        click.echo(before)
        click.echo(indent(json.dumps(document, indent=2, ensure_ascii=False), "  "), nl=False)
        before = ","
    click.echo("[]" if before == "[" else "\n]")


def failure_line(record: Record) -> str:
    """The message about a shape that failed.

    Parameters
    ----------
    record : Record
        The record of the failure.

    Returns
    -------
    str
        Id, stage and message; and the file, if the message does not name it.
    """
    file = "" if record.path in (record.message or "") else f" ({record.path})"
    return f"failed: [{record.id} / {record.stage}] {record.message}{file}"


def step_lines(steps: tuple[Step, ...]) -> list[str]:
    """Provenance as text.

    Parameters
    ----------
    steps : tuple of Step
        The steps.

    Returns
    -------
    list of str
        One line for each step (stage, seconds, sizes), and one for each note.
    """
    lines = []
    for step in steps:
        sizes = ", ".join(
            f"{name} {value:.3g}" if value % 1 else f"{name} {value:.0f}"
            for name, value in step.sizes.items()
        )
        lines.append(f"{step.stage:<9} {step.seconds:7.3f} s  {sizes}")
        lines += [f"{'':<9}            {note}" for note in step.notes]
    return lines
