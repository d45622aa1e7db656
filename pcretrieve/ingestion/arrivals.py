"""The scans that arrive in a folder, as soon as they stop growing."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import TypeAlias

from pcretrieve.errors import InputError, ScanReadError
from pcretrieve.formats import Part, is_scan, parts_of
from pcretrieve.ingestion.discover import discover

__all__ = ["Arrivals"]

# Inode, bytes, and time of the last change, nanoseconds.
State: TypeAlias = tuple[int, int, int]


class Arrivals:
    """Looks into a folder, and finds the files that have not changed since the last look.

    The folder is read at each look, instead of being watched by the kernel (inotify, kqueue): the kernel
    reports nothing that another computer writes to a network file system, loses events when a queue is full,
    and would need a package for each system; to read a folder of ten thousand files takes some 50 ms.
    """

    def __init__(self, folder: Path) -> None:
        if not folder.is_dir():
            raise InputError(f"there is no folder {folder} to watch: make it, or name another")
        self._folder = folder.absolute()
        self._seen: dict[Path, State] = {}
        self._given: dict[Path, State] = {}
        self._parts: dict[Path, tuple[Part, ...]] = {}  # of the scans that consist of several files

    def look(self) -> list[Path]:
        """Find the scans whose files are unchanged since the last look, and changed since they were found.

        A scan of several files is found when all its views are there.
        """
        now = _states(self._folder)
        still = {path for path, state in now.items() if self._seen.get(path) == state}
        self._seen = now
        fresh = {path for path in still if self._given.get(path) != now[path]}
        for path in fresh:
            self._given[path] = now[path]
            self._parts.pop(path, None)
            with suppress(OSError, ScanReadError):  # reading the file as a scan will report the error
                if parts := parts_of(path):
                    self._parts[path] = parts
        owned = {part.path for parts in self._parts.values() for part in parts}
        found = {path for path in fresh - owned if path not in self._parts and is_scan(path)}
        for path, parts in self._parts.items():
            files = {path, *(part.path for part in parts)}
            needed = {path, *(part.path for part in parts if part.pose is not None), *(files & now.keys())}
            if files & fresh and needed <= still:
                found.add(path)
        return discover(sorted(found))


def _states(folder: Path) -> dict[Path, State]:
    """The state of each file in a folder that is not hidden; files that vanish meanwhile are left out."""
    states = {}
    for place, _, names in os.walk(folder):
        for name in names:
            path = Path(place, name)
            with suppress(OSError):
                if not name.startswith("."):
                    found = path.stat()
                    states[path] = found.st_ino, found.st_size, found.st_mtime_ns
    return states
