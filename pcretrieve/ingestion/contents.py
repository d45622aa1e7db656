"""Scans → hashes of their contents, computed in the background."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from threading import Condition, Thread

from pcretrieve.errors import ShapeError, Stage, StageTimeout
from pcretrieve.formats import split_member
from pcretrieve.ingestion.discover import file_hash, scan_hash

__all__ = ["Contents"]


class Contents:
    """Hashes of scans, computed in threads: in advance with `expect`, or on demand with `of`.

    Each file is read once, also if it holds several scans.

    Parameters
    ----------
    scans : mapping of str to Path
        Scans by name.
    n_threads : int
        Number of files that are read at the same time. Hashing and reading release the interpreter lock.
    timeout : float
        Longest time to read one file; seconds. Reading a file on a network that is not connected may never
        end: its thread then continues, is not counted, and does not prevent the program from ending.
    """

    def __init__(self, scans: Mapping[str, Path], n_threads: int, timeout: float) -> None:
        self._scans = scans
        self._n_threads = n_threads
        self._timeout = timeout
        self._changed = Condition()  # guards the attributes below
        self._known: dict[Path, str | Exception] = {}
        self._expected: dict[Path, None] = {}  # in the order in which they are to be read
        self._deadlines: dict[Path, float] = {}  # of the files that are being read

    def expect(self, names: Iterable[str]) -> None:
        """Begin to hash scans in the background."""
        with self._changed:
            for name in names:
                file, _ = split_member(self._scans[name])
                if file not in self._known and file not in self._deadlines:
                    self._expected[file] = None
            self._start()

    def of(self, name: str) -> str | ShapeError:
        """The SHA-256 hash of a scan, or the error of reading its file."""
        self.expect([name])
        scan = self._scans[name]
        file, _ = split_member(scan)
        with self._changed:
            while file not in self._known:
                self._changed.wait(min(self._deadlines.values()) - time.monotonic())
                self._give_up()
            content = self._known[file]
        if isinstance(content, str):
            return scan_hash(scan, content)
        if isinstance(content, ShapeError):
            return content
        raise content

    def close(self) -> None:
        """Hash no more files."""
        with self._changed:
            self._expected.clear()

    def _start(self) -> None:
        while self._expected and len(self._deadlines) < self._n_threads:
            file = next(iter(self._expected))
            del self._expected[file]
            self._deadlines[file] = time.monotonic() + self._timeout
            # A daemon thread, because a program waits for the threads of a thread pool before it ends.
            Thread(target=self._read, args=(file,), daemon=True).start()

    def _read(self, file: Path) -> None:
        try:
            content: str | Exception = file_hash(file)
        except Exception as error:  # noqa: BLE001  `of` raises it
            content = error
        with self._changed:
            self._finish(file, content)

    def _give_up(self) -> None:
        now = time.monotonic()
        for file in [file for file, deadline in self._deadlines.items() if deadline <= now]:
            message = f"{file} was not read within {self._timeout:g} s: raise --timeout"
            self._finish(file, StageTimeout(message, stage=Stage.READ))

    def _finish(self, file: Path, content: str | Exception) -> None:
        if self._deadlines.pop(file, None) is not None:  # otherwise its time limit was exceeded
            self._known[file] = content
            self._start()
            self._changed.notify_all()
