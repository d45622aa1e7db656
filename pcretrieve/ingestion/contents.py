"""Scans → hashes of their contents, computed in the background."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from threading import Condition, Thread

from pcretrieve.catalogue import Record
from pcretrieve.errors import ShapeError, Stage, StageTimeout
from pcretrieve.formats import split_member
from pcretrieve.ingestion.discover import file_hash, scan_hash
from pcretrieve.ingestion.stamps import SETTLED, stamp_of

__all__ = ["Contents"]


class Contents:
    """Hashes of scans, computed in threads: in advance with `expect`, or on demand with `of`.

    Each file is read once, also if it holds several scans. A file whose stamp is that of its record is not
    read: its hash is that of the record.

    timeout: longest time to read one file; seconds. Reading a file on a network that is not connected may
        never end: its thread then continues, is not counted, and does not prevent the program from ending.
    """

    def __init__(
        self, scans: Mapping[str, Path], n_threads: int, timeout: float, records: Iterable[Record] = ()
    ) -> None:
        self._scans = scans
        self._records = {record.path: record for record in records if record.stamp and record.content_hash}
        self._stamps_of_records = self._by_file()
        self._n_threads = n_threads
        self._timeout = timeout
        self._changed = Condition()  # guards the attributes below
        self._known: dict[Path, str | Exception | None] = {}  # None: a file that has not changed
        self._stamps: dict[Path, str] = {}
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
        if content is None:
            return self._records[name].content_hash
        if isinstance(content, str):
            return scan_hash(scan, content)
        if isinstance(content, ShapeError):
            return content
        raise content

    def stamp(self, name: str) -> str | None:
        """The stamp of a scan that `of` has hashed; None if it does not suffice to know the file again."""
        file, _ = split_member(self._scans[name])
        with self._changed:
            return self._stamps.get(file)

    def close(self) -> None:
        """Hash no more files."""
        with self._changed:
            self._expected.clear()

    def _by_file(self) -> dict[Path, str]:
        """The stamps of the files whose scans all have a record with the same stamp."""
        if not self._records:
            return {}
        found: dict[Path, set[str | None]] = {}
        for name, scan in self._scans.items():
            record = self._records.get(name)
            found.setdefault(split_member(scan)[0], set()).add(record.stamp if record else None)
        return {file: stamp for file, (stamp, *others) in found.items() if stamp and not others}

    def _start(self) -> None:
        while self._expected and len(self._deadlines) < self._n_threads:
            file = next(iter(self._expected))
            del self._expected[file]
            self._deadlines[file] = time.monotonic() + self._timeout
            # A daemon thread, because a program waits for the threads of a thread pool before it ends.
            Thread(target=self._read, args=(file,), daemon=True).start()

    def _read(self, file: Path) -> None:
        content: str | Exception | None = None
        settled = None
        try:
            now, stamp = time.time(), stamp_of(file)
            if stamp is None or stamp.text != self._stamps_of_records.get(file):
                content = file_hash(file)
                # A file that was written meanwhile has one of two stamps.
                if stamp is not None and stamp.changed < now - SETTLED and stamp == stamp_of(file):
                    settled = stamp.text
        except Exception as error:  # noqa: BLE001  `of` raises it
            content = error
        with self._changed:
            if settled is not None:
                self._stamps[file] = settled
            self._finish(file, content)

    def _give_up(self) -> None:
        now = time.monotonic()
        for file in [file for file, deadline in self._deadlines.items() if deadline <= now]:
            message = f"{file} was not read within {self._timeout:g} s: raise --timeout"
            self._finish(file, StageTimeout(message, stage=Stage.READ))

    def _finish(self, file: Path, content: str | Exception | None) -> None:
        if self._deadlines.pop(file, None) is not None:  # otherwise its time limit was exceeded
            self._known[file] = content
            self._start()
            self._changed.notify_all()
