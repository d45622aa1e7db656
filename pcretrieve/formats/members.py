"""Several scans in one file: their names, and the path ``file#name`` of one of them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

from pcretrieve.formats.raw import RawScan

__all__ = ["MARK", "Members", "distinct_names"]

# Separator between the name of a file and the name of a scan in it.
MARK = "#"
# Characters that a path must not have, and the separator.
UNSAFE = re.compile(r"[\x00-\x1f\x7f/\\#]+")
# Longest name; file systems allow 255 bytes for the name of a file.
LONGEST = 80


class Members(NamedTuple):
    """Functions that read single scans of a file with several scans."""

    names: Callable[[Path], tuple[str, ...]]
    read: Callable[[Path, str], RawScan]


def distinct_names(names: Iterable[str]) -> list[str]:
    """Convert names to distinct names that can be parts of a path."""
    found: dict[str, None] = {}
    counts: dict[str, int] = {}
    for number, name in enumerate(names, start=1):
        plain = UNSAFE.sub("_", name).strip()[:LONGEST].strip("_ ") or str(number)
        distinct = plain
        while distinct in found:
            counts[plain] = counts.get(plain, 1) + 1
            distinct = f"{plain}-{counts[plain]}"
        found[distinct] = None
    return list(found)
