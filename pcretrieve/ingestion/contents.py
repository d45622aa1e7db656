"""Files → hashes of their contents, computed in the background."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from threading import Condition, Thread

from pcretrieve.errors import ShapeError, Stage, StageTimeout
from pcretrieve.ingestion.discover import content_hash

__all__ = ["Contents"]


class Contents:
    """Hashes of files, each computed once, in threads: in advance with `expect`, or on demand with `of`.

    Parameters
    ----------
    files : mapping of str to Path
        Files by name.
    n_threads : int
        Number of files that are read at the same time. Hashing and reading release the interpreter lock.
    timeout : float
        Longest time to read one file; seconds. Reading a file on a network that is not connected may never
        end: its thread then continues, is not counted, and does not prevent the program from ending.
    """

    def __init__(self, files: Mapping[str, Path], n_threads: int, timeout: float) -> None:
        self._files = files
        self._n_threads = n_threads
        self._timeout = timeout
        self._changed = Condition()  # guards the attributes below
        self._known: dict[str, str | Exception] = {}
        self._expected: dict[str, None] = {}  # in the order in which they are to be read
        self._deadlines: dict[str, float] = {}  # of the files that are being read

    def expect(self, names: Iterable[str]) -> None:
        """Begin to hash files in the background."""
        with self._changed:
            for name in names:
                if name not in self._known and name not in self._deadlines:
                    self._expected[name] = None
            self._start()

    def of(self, name: str) -> str | ShapeError:
        """The SHA-256 hash of a file, or the error of reading it."""
        self.expect([name])
        with self._changed:
            while name not in self._known:
                self._changed.wait(min(self._deadlines.values()) - time.monotonic())
                self._give_up()
            content = self._known[name]
        if isinstance(content, Exception) and not isinstance(content, ShapeError):
            raise content
        return content

    def close(self) -> None:
        """Hash no more files."""
        with self._changed:
            self._expected.clear()

    def _start(self) -> None:
        while self._expected and len(self._deadlines) < self._n_threads:
            name = next(iter(self._expected))
            del self._expected[name]
            self._deadlines[name] = time.monotonic() + self._timeout
            # A daemon thread, because a program waits for the threads of a thread pool before it ends.
            Thread(target=self._read, args=(name,), daemon=True).start()

    def _read(self, name: str) -> None:
        try:
            content: str | Exception = content_hash(self._files[name])
        except Exception as error:  # noqa: BLE001  `of` raises it
            content = error
        with self._changed:
            self._finish(name, content)

    def _give_up(self) -> None:
        now = time.monotonic()
        for name in [name for name, deadline in self._deadlines.items() if deadline <= now]:
            message = f"{self._files[name]} was not read within {self._timeout:g} s: raise --timeout"
            self._finish(name, StageTimeout(message, stage=Stage.READ))

    def _finish(self, name: str, content: str | Exception) -> None:
        if self._deadlines.pop(name, None) is not None:  # otherwise its time limit was exceeded
            self._known[name] = content
            self._start()
            self._changed.notify_all()
