"""Rows → the text of a CSV file."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence

__all__ = ["csv_text"]


class _Lines(list[str]):
    """What a writer of the standard library writes to, once for each row."""

    write = list.append


def csv_text(header: Sequence[object], rows: Iterable[Sequence[object]]) -> str:
    """Write rows as comma-separated values, from which any reader gets the same fields again."""
    # With the line ends of RFC 4180, because a writer with other ends does not quote a carriage return.
    lines = _Lines()
    writer = csv.writer(lines)
    writer.writerow(header)
    writer.writerows(rows)
    return "".join(line.removesuffix("\r\n") + "\n" for line in lines)
