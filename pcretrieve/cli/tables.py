"""The tables that commands print: with headings; on a terminal as wide as it is, for programs in full."""

from __future__ import annotations

import os
import shutil
import sys
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice, zip_longest
from typing import TYPE_CHECKING, NamedTuple
from unicodedata import combining, east_asian_width

import click

from pcretrieve.cli.messages import escaped, print_text

if TYPE_CHECKING:
    from pcretrieve.values import Step

__all__ = ["Column", "write_steps", "write_table"]

# Number of rows from which the widths of columns are found, so that long tables are printed as they are read.
BLOCK = 1000

GAP = "  "

# Least numbers of characters in columns that are narrowed, in the order in which they are.
NARROWED = (("path", 24), ("words", 24), ("path", 12), ("text", 8))

# Colours of the words that say that something is wrong.
COLOURS = {"doubtful": "yellow", "unusable": "red", "failed": "red"}


class Column(NamedTuple):
    """A column of a table."""

    heading: str
    kind: str = "text"


def write_table(columns: Sequence[Column], rows: Iterable[Sequence[str]]) -> int:
    """Print a table, on standard output; nothing, if there are no rows."""
    limit = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
    headings = [column.heading for column in columns]
    widths = [0] * len(columns)
    remaining, n_rows = iter(rows), 0
    while block := list(islice(remaining, BLOCK)):
        cells = [[escaped(cell) for cell in row] for row in block]
        # Later rows of long tables are at least as wide as the first ones.
        widths = [
            max(widest, *map(_width, column))
            for widest, column in zip(widths, zip(headings, *cells, strict=True), strict=True)
        ]
        shown = widths if limit is None else _fitted(columns, widths, limit)
        has_heading = not n_rows and any(headings)
        lines = list(_lines(columns, headings, shown, is_heading=True)) if has_heading else []
        for row in cells:
            lines += _lines(columns, row, shown)
        print_text("\n".join(lines))
        n_rows += len(block)
    return n_rows


def write_steps(steps: Iterable[Step]) -> None:
    """Print provenance, on standard output: a row for each step, and one for each note."""
    rows = []
    for step in steps:
        sizes = (
            f"{name} {value:.3g}" if value % 1 else f"{name} {value:.0f}"
            for name, value in step.sizes.items()
        )
        rows.append((step.stage, f"{step.seconds:.3f}", ", ".join(sizes)))
        rows += [("", "", note) for note in step.notes]
    write_table((Column("STAGE"), Column("SECONDS", "number"), Column("SIZES AND NOTES", "words")), rows)


def _lines(
    columns: Sequence[Column], cells: Sequence[str], widths: Sequence[int], *, is_heading: bool = False
) -> Iterator[str]:
    """The line of a row, or several lines, if words are broken."""
    parts = [
        textwrap.wrap(cell, width, break_on_hyphens=False)
        if column.kind == "words" and _width(cell) > width
        else [_shortened(cell, width)]
        for column, cell, width in zip(columns, cells, widths, strict=True)
    ]
    for line in zip_longest(*parts, fillvalue=""):
        padded = [
            _padded(text, width, column.kind, is_heading=is_heading)
            for column, text, width in zip(columns, line, widths, strict=True)
        ]
        yield GAP.join(padded).rstrip()


def _styled(text: str, colour: str | None, is_heading: bool) -> str:
    """A cell with codes of a terminal, which are not printed elsewhere."""
    if not text or not (colour or is_heading) or os.environ.get("NO_COLOR"):
        return text
    return click.style(text, fg=colour, bold=is_heading or None)


def _fitted(columns: Sequence[Column], widths: Sequence[int], limit: int) -> list[int]:
    """Widths whose row has at most `limit` characters, if columns can be narrowed so far."""
    fitted = [*widths]
    for kind, least in NARROWED:
        for number, column in enumerate(columns):
            excess = sum(fitted) + len(GAP) * (len(fitted) - 1) - limit
            if column.kind == kind and excess > 0 and fitted[number] > least:
                fitted[number] = max(least, len(column.heading), fitted[number] - excess)
    return fitted


def _width(text: str) -> int:
    """The number of columns of a terminal that a text takes."""
    if text.isascii():
        return len(text)
    return sum(0 if combining(sign) else 2 if east_asian_width(sign) in "WF" else 1 for sign in text)


def _padded(text: str, width: int, kind: str, *, is_heading: bool) -> str:
    blanks, shown = " " * (width - _width(text)), _styled(text, COLOURS.get(text), is_heading)
    return blanks + shown if kind == "number" else shown + blanks


def _shortened(text: str, width: int) -> str:
    """The beginning and the end of a text that takes more than a width, with an ellipsis between them."""
    if _width(text) <= width:
        return text
    first, last = "", text
    while _width(first) < (width - 1) // 3:
        first += text[len(first)]
    while _width(first) + 1 + _width(last) > width:
        last = last[1:]
    return f"{first}…{last}"
