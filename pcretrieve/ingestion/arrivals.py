"""The scans that arrive in a folder, processed as soon as they stop growing."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

from pcretrieve.catalogue import CatalogueLike, Record, opened
from pcretrieve.errors import InputError, ScanReadError
from pcretrieve.formats import Part, is_scan, parts_of
from pcretrieve.ingestion.discover import discover
from pcretrieve.ingestion.plan import Processing
from pcretrieve.ingestion.pool import Executor, in_processes
from pcretrieve.ingestion.run import Summary, process_scans
from pcretrieve.options import OptionsLike, PipelineOptions

# Inode, bytes, and time of the last change, nanoseconds.
State = tuple[int, int, int]


def watch(
    folder: str | Path,
    catalogue: CatalogueLike,
    *,
    options: OptionsLike = None,
    interval: float = 5.0,
    workers: int | None = None,
    timeout: float = 600.0,
    memory: float | None = None,
    executor: Executor = in_processes,
    retries: int = 0,
    on_shape: Callable[[Record], None] = lambda record: None,
) -> Iterator[Summary]:
    """Process the scans that are in a folder, and those that arrive, as soon as they stop growing.

    A file is processed when two looks have found it unchanged. One that changes afterwards is processed
    again, and replaces its earlier result.

    Parameters
    ----------
    folder : str or Path
        The folder, with its subfolders.
    catalogue : Catalogue, str or Path
        The catalogue in which the shapes are stored. A file that does not exist is created.
    options : OptionsLike, optional
        The options of a new catalogue. By default the options of an existing catalogue, or the defaults.
    interval : float, default 5
        Time between two looks into the folder; seconds.
    workers, timeout, memory, executor, retries, on_shape : object, optional
        As for `pcretrieve.ingest`.

    Yields
    ------
    Summary
        The records of the scans that have arrived together, after they were processed. There is no last one.

    Raises
    ------
    InputError
        If there is no such folder.
    OptionError
        If there is no such option.
    CatalogueError
        If the catalogue was built with other options, or cannot be opened or written.
    """
    arrivals = Arrivals(Path(folder))
    chosen = None if options is None else PipelineOptions.of(options)
    how = Processing(workers, timeout, memory, executor, retries=retries, on_shape=on_shape)
    with opened(catalogue, chosen, create=True) as store:
        while True:
            if scans := arrivals.look():
                yield process_scans(scans, store, how)
            else:
                time.sleep(interval)


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
        now = self._states()
        still = {path for path, state in now.items() if self._seen.get(path) == state}
        fresh = {path for path in still if self._given.get(path) != now[path]}
        self._seen = now
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

    def _states(self) -> dict[Path, State]:
        """The state of each file that is not hidden; files that vanish meanwhile are left out."""
        states = {}
        for place, _, names in os.walk(self._folder):
            for path in (Path(place, name) for name in names if not name.startswith(".")):
                with suppress(OSError):
                    found = path.stat()
                    states[path] = found.st_ino, found.st_size, found.st_mtime_ns
        return states
