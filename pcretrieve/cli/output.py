"""What programs read on standard output: lines, tables, CSV, and JSON documents."""

from __future__ import annotations

import json
import os
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, Any, NamedTuple

import click

import pcretrieve as pr
from pcretrieve.cli.messages import (
    ESCAPES,
    broken,
    escaped,
    stop_waiting,
    tell,
    without_password,
)
from pcretrieve.errors import OptionError, PcretrieveError

if TYPE_CHECKING:
    from pcretrieve.values import Failure

EXIT_ERROR = 1
EXIT_USAGE = 2
EXIT_SOME_FAILED = 3
EXIT_INTERRUPTED = 130

#: The options of commands that print one document, or a line for each element of a list.
JSON_FLAG = "--json"
JSON_LINES_FLAG = "--jsonl"

# Which of the two was given, and the elements that the document has, in the state of a command.
FORM = "pcretrieve.json"
ELEMENTS = "pcretrieve.elements"

# A JSON document has escaped these in its strings; others are between its values.
ESCAPES_IN_JSON = {code: escape for code, escape in ESCAPES.items() if code != ord("\n")}

# Number of rows from which the widths of columns are found, so that long tables are printed as they are read.
BLOCK = 1000

GAP = "  "

# Least number of characters in a column of sentences, which are broken on a narrow terminal.
LEAST_WORDS = 24

# Colours of the words that say that something is wrong.
COLOURS = {"poor": "yellow", "incomplete": "yellow", "failed": "red"}


def print_text(text: str) -> None:
    """Print the text of a result."""
    stop_waiting()
    click.echo(text)


def write_lines(*texts: str) -> None:
    """Print lines of a result."""
    for text in texts:
        print_text(escaped(text))


def write_words(text: str) -> None:
    """Print a sentence of a result; on a terminal, broken between words."""
    print_text(broken(escaped(without_password(text)), sys.stdout))


def write_csv(text: str) -> None:
    """Print the text of a CSV file: as it is for a program, escaped for a terminal."""
    shown = text.translate(ESCAPES_IN_JSON) if sys.stdout.isatty() else text
    stop_waiting()
    # In colour, or click removes what looks like codes of a terminal.
    click.echo(shown, nl=False, color=True)


# The headings of a table, each with the kind of its cells: text, number, path, or in the last column words.
Columns = Mapping[str, str]


def write_table(
    columns: Columns, rows: Iterable[Sequence[str]], *, err: bool = False
) -> int:
    """Print a table with headings, on a terminal as wide as it is; nothing, if there are no rows.

    A narrow terminal gets no files, and broken sentences; ids are never cut, because people copy them. Not by
    the tables of rich, which take two minutes for 100,000 rows, and print none before they have all.
    """
    stream, write = (sys.stderr, tell) if err else (sys.stdout, print_text)
    limit = shutil.get_terminal_size().columns if stream.isatty() else None
    heading, kinds, widths = [*columns], [*columns.values()], [0] * len(columns)
    remaining, n_rows = iter(rows), 0
    while block := list(islice(remaining, BLOCK)):
        cells = [[escaped(cell) for cell in row] for row in block]
        if not n_rows and any(name.strip() for name in heading):
            cells.insert(0, heading)
        # Later rows of long tables are at least as wide as the first ones.
        widths = [
            max(widest, *map(_width, column))
            for widest, column in zip(widths, zip(*cells, strict=True), strict=True)
        ]
        least = sum(widths) + len(GAP) * (len(widths) - 1)
        if kinds[-1] == "words":
            least -= max(0, widths[-1] - LEAST_WORDS)
        left_out = "path" if limit is not None and least > limit else None
        lines = []
        for row in cells:
            parts = zip(kinds, widths, row, strict=True)
            shown = [part for part in parts if part[0] != left_out]
            lines.append(_line(shown, limit, is_heading=row is heading))
        write("\n".join(lines))
        n_rows += len(block)
    return n_rows


def _line(
    parts: Sequence[tuple[str, int, str]], limit: int | None, *, is_heading: bool
) -> str:
    """The line of a row, of kinds, widths and cells; or several lines, if words are broken."""
    padded, start = [], 0
    for kind, width, text in parts:
        blanks, lines = " " * (width - _width(text)), [text]
        if kind == "words" and limit is not None:
            room = max(LEAST_WORDS, limit - start)
            lines = textwrap.wrap(text, room, break_on_hyphens=False)
        cell = f"\n{' ' * start}".join(_styled(line, is_heading) for line in lines)
        padded.append(blanks + cell if kind == "number" else cell + blanks)
        start += width + len(GAP)
    return GAP.join(padded).rstrip()


def write_steps(steps: Iterable[pr.Step]) -> None:
    """Print provenance: a row for each step, and one for each note."""
    rows = []
    for step in steps:
        sizes = (
            f"{name} {value:.3g}" if value % 1 else f"{name} {value:.0f}"
            for name, value in step.sizes.items()
        )
        rows.append((step.stage, f"{step.seconds:.3f}", ", ".join(sizes)))
        rows += [("", "", note) for note in step.notes]
    write_table({"STAGE": "text", "SECONDS": "number", "SIZES AND NOTES": "words"}, rows)


def _styled(text: str, is_heading: bool) -> str:
    """A cell with codes of a terminal, which click does not print elsewhere."""
    colour = COLOURS.get(text)
    if not text or not (colour or is_heading) or os.environ.get("NO_COLOR"):
        return text
    return click.style(text, fg=colour, bold=is_heading or None)


def _width(text: str) -> int:
    """The number of columns of a terminal that a text takes."""
    if text.isascii():
        return len(text)
    from rich.cells import cell_len

    return cell_len(text)


# --- results and documents -----------------------------------------------------------------------------


class Result(NamedTuple):
    """What a command returns, to be printed.

    value: for JSON; the elements of an iterator are computed while they are printed.
    options: the settings that led to it.
    show: prints it for people.
    failed: whether the exit code is not 0 but `exit_code`, known when the result is printed.
    """

    value: object
    options: pr.PipelineOptions | None = None
    show: Callable[[], object] = lambda: None
    failed: object = False
    exit_code: int = EXIT_SOME_FAILED


def choose_json(
    context: click.Context, parameter: click.Parameter, is_given: bool
) -> None:
    """Let the command print JSON."""
    if is_given:
        context.meta[FORM] = parameter.opts[0]


def prints_json() -> bool:
    """Whether the command prints JSON, as a document or as lines."""
    return FORM in click.get_current_context().meta


def check_one_form(*, as_csv: bool) -> None:
    """Raise an error if a command is asked for JSON and for CSV."""
    if as_csv and prints_json():
        raise click.UsageError("choose one of --json and --csv")


def print_result(result: Result) -> None:
    """Print a result for people, or its document: what was asked, by which version, and the result.

    As JSON Lines, the elements of a list are printed as soon as they are known, and nothing else.
    """
    context, value = click.get_current_context(), result.value
    form = context.meta.get(FORM)
    if form is None:
        result.show()
    elif form == JSON_LINES_FLAG:
        for element in value if isinstance(value, (Iterator, list)) else [value]:
            print_text(_text(element, indent=None))
    else:
        if isinstance(value, Iterator):
            # Also an error on the way has what was known before it.
            elements = context.meta[ELEMENTS] = []
            elements.extend(value)
            value = elements
        print_text(_text(_head(context, result.options) | {"result": value}))


@contextmanager
def errors_as_json(context: click.Context, is_json: bool) -> Iterator[None]:
    """Print the document, or the line, of a command that fails, and let its error through."""
    try:
        yield
    except (PcretrieveError, click.ClickException) as error:
        facts = failure_facts(error) | {"exit_code": exit_code(error)}
        if is_json and context.meta.get(FORM) == JSON_LINES_FLAG:
            print_text(_text(facts, indent=None))
        elif is_json:
            known = (
                {"result": elements} if (elements := context.meta.get(ELEMENTS)) else {}
            )
            print_text(_text(_head(context, None) | known | facts))
        raise


def exit_code(error: PcretrieveError | click.ClickException) -> int:
    """The code with which a command ends after an error."""
    if isinstance(error, click.ClickException):
        return error.exit_code
    return EXIT_USAGE if isinstance(error, OptionError) else EXIT_ERROR


def failure_facts(
    failure: PcretrieveError | click.ClickException | pr.Record | Failure,
) -> dict[str, Any]:
    """What failed, for JSON: the name of the exception, the stage, if there is one, and the message."""
    kind = type(failure).__name__ if isinstance(failure, Exception) else failure.error
    return {
        "error": kind,
        "stage": getattr(failure, "stage", None),
        "message": failure.message,
    }


def _head(context: click.Context, options: pr.PipelineOptions | None) -> dict[str, Any]:
    arguments = {}
    for one in context.command.params:
        value = context.params.get(str(one.name))
        if value is not None:
            # The name of an option as it is typed, without hyphens.
            name = max(one.opts, key=len).lstrip("-").replace("-", "_")
            arguments[name] = without_password(value) if isinstance(value, str) else value
    return {
        "command": context.command_path.partition(" ")[2],
        "version": pr.__version__,
        "arguments": arguments,
        "options": options,
    }


def _text(document: object, indent: int | None = 2) -> str:
    from pydantic_core import to_jsonable_python

    # It knows paths, options and other dataclasses; the rest is arrays and their elements.
    plain = partial(to_jsonable_python, fallback=lambda array: array.tolist())
    text = json.dumps(document, indent=indent, ensure_ascii=False, default=plain)
    return text.translate(ESCAPES_IN_JSON)
