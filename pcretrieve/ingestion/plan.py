"""Scans and the records of a catalogue → a plan: which scans must be processed, and which records changed.

Files are identified by their content, which is hashed in the background. A file that was renamed keeps its
record, and a file with new content is processed again.
"""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, TimeoutError
from dataclasses import dataclass, field, replace
from functools import cache, partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from threading import Semaphore, Thread
from typing import Any, NamedTuple

from pcretrieve import __version__
from pcretrieve.catalogue import Catalogue, CatalogueLike, Record
from pcretrieve.errors import (
    BenchmarkError,
    PcretrieveError,
    ScanReadError,
    ShapeError,
    Stage,
    StageTimeout,
    did_you_mean,
    shape_error,
)
from pcretrieve.formats import ScanPath
from pcretrieve.formats.identity import (
    file_hash,
    of_each_file,
    printable,
    scan_hash,
)
from pcretrieve.ingestion.discover import scans_of, shape_ids
from pcretrieve.ingestion.labels import discover_labelled, match_labels
from pcretrieve.ingestion.pool import Executor, alone, in_processes, n_cores

logger = logging.getLogger(__name__)

Identity = tuple[str, str]  # suffix and SHA-256 of a file

# Least time between the last change of a file and its hashing for its stamp to be stored; seconds. A file
# that is changed again directly after it was hashed may have the same times, which some file systems round to
# two seconds (git calls such files racy), and the clock of a file server may differ from that of this
# computer.
SETTLED = 60.0

# Number of files that are planned together: large enough for few transactions, small enough to begin soon.
FILES_AT_ONCE = 32


@cache
def versions() -> dict[str, str]:
    """Versions of pcretrieve and of the libraries on which results depend, by package name."""
    # Not from metadata: a source folder on the path has no metadata, or the metadata of another version.
    others = {name: version(name) for name in ("pytetwild", "numpy", "scipy")}
    try:
        open3d = version("open3d")
    except PackageNotFoundError:  # its package without CUDA has another name
        open3d = version("open3d-cpu")
    return {"pcretrieve": __version__, "open3d": open3d} | others


def failed(record: Record, error: PcretrieveError) -> Record:
    """Make a record of a failure."""
    return replace(
        record,
        status="failed",
        stage=str(error.stage or Stage.WORKER),
        error=type(error).__name__,
        message=printable(error.message),
    )


@dataclass(frozen=True, slots=True)
class Processing:
    """How scans are processed; the attributes are parameters of `ingest`."""

    workers: int | None = None
    timeout: float = 600.0
    memory: float | None = None
    executor: Executor = in_processes
    retry_failed: bool = False
    retries: int = 0
    max_failures: int | None = None
    on_shape: Callable[[Record], None] = lambda record: None

    @property
    def limits(self) -> dict[str, Any]:
        """Those of an executor."""
        return {"workers": self.workers, "timeout": self.timeout, "memory": self.memory}


@dataclass(frozen=True, slots=True, eq=False)
class Intake:
    """The scans that were found for an ingest, and their classes.

    part: the scans of the shard that is processed, or all.
    label_file: where the labels are from, for messages.
    """

    scans: Sequence[ScanPath]
    part: Sequence[ScanPath]
    labels: Mapping[str, str] = field(default_factory=dict)
    label_file: str | Path | None = None

    @classmethod
    def found(
        cls,
        paths: str | Path | Sequence[str | Path],
        labels: str | Path | Mapping[str, str] | None,
        catalogue: CatalogueLike,
        shard: str | None,
        limits: Mapping[str, Any],
    ) -> Intake:
        """What the arguments of `ingest` name."""
        file = labels if isinstance(labels, (str, Path)) else None
        scans, found = discover_labelled(
            [paths] if isinstance(paths, (str, Path)) else paths,
            file,
            [catalogue] if isinstance(catalogue, (str, Path)) else [],
            limits,
        )
        given = labels if isinstance(labels, Mapping) else found
        return cls(scans, scans_of(shard, scans), given, file)


@dataclass(slots=True, eq=False)
class Plan:
    """What an ingest does with some files. Paths are printable, as catalogues store them."""

    moved: dict[str, str] = field(default_factory=dict)  # new path by old path
    removed: list[str] = field(default_factory=list)  # paths whose records are removed
    labels: dict[str, str] = field(default_factory=dict)  # by path
    stamps: dict[str, str] = field(default_factory=dict)  # by path
    # Of scans that the catalogue has already.
    held: list[Record] = field(default_factory=list)
    # Files with the same content as another file, and the record of the other file.
    duplicates: list[tuple[str, Record]] = field(default_factory=list)
    # Scans that must be processed, and their new records; the id may still change.
    process: list[tuple[ScanPath, Record]] = field(default_factory=list)
    # Failures of files that cannot be read.
    unreadable: list[Record] = field(default_factory=list)

    def apply(self, catalogue: Catalogue) -> None:
        """Write the changes to the records of a catalogue, and complete those of skipped scans by its own."""
        if self.moved or self.removed or self.labels or self.stamps:
            catalogue.rows.revise(
                moved=self.moved,
                removed=self.removed,
                labels=self.labels,
                stamps=self.stamps,
            )
        known = [*self.held, *(original for _, original in self.duplicates)]
        stored = catalogue.rows.several({record.id for record in known})
        whole = {(record.path, record.content_hash): record for record in stored}

        def completed(record: Record) -> Record:
            # An original that is still to be processed has a new content, and no provenance.
            return whole.get((record.path, record.content_hash), record)

        self.held = [completed(record) for record in self.held]
        self.duplicates = [
            (path, completed(original)) for path, original in self.duplicates
        ]


class Planner:
    """Decides what must be done with each scan, file by file, and writes nothing.

    names: of the scans of the shard that is processed.
    """

    def __init__(
        self, intake: Intake, records: Sequence[Record], how: Processing
    ) -> None:
        labels = intake.labels
        self.files = {printable(scan): scan for scan in intake.scans}
        chosen = {*intake.part}
        self.names = [name for name, scan in self.files.items() if scan in chosen]
        n_threads = how.workers or n_cores()
        self.contents = Contents(self.files, n_threads, how.timeout, records)
        self._retry_failed = how.retry_failed
        self._held = {record.path: record for record in records}
        self._ids = shape_ids(self.files, {record.id: record.path for record in records})
        matched, unknown = match_labels(
            labels, {self._ids[name]: name for name in self.files}
        )
        _check_labels(matched, unknown, intake, self.files, records)
        self._labels = {
            name: matched[self._ids[name]]
            for name in self.files
            if self._ids[name] in matched
        }
        self._labels_left = {name: labels[name] for name in unknown}
        self._same: dict[Identity, list[Record]] = {}
        self._gone: dict[Identity, Record] = {}
        self._queued: dict[Identity, Record] = {}
        for record in records:
            if record.content_hash:
                identity = _identity(ScanPath.parse(record.path), record.content_hash)
                self._same.setdefault(identity, []).append(record)
                if record.path not in self.files and _is_gone(record.path):
                    self._gone[identity] = record

    @property
    def unknown_labels(self) -> list[str]:
        """Names in the label file that match no scan, so far as files were planned."""
        return list(self._labels_left)

    def plans(self) -> Iterator[Plan]:
        """Yield plans for some files at a time; meanwhile, the contents of the next files are hashed."""
        before = (record.label for record in self._held.values() if record.label)
        classes = {*self._labels.values(), *before}
        if len(classes) == 1 and len(self._labels) > 1:
            words = "all labelled shapes are of one class, %s: scores and measures need two or more"
            logger.warning(words, *classes)
        for start in range(0, len(self.names), FILES_AT_ONCE):
            self.contents.expect(self.names[start : start + 2 * FILES_AT_ONCE])
            made = Plan()
            for name in self.names[start : start + FILES_AT_ONCE]:
                self._add(name, made)
            yield made

    def changed(self, records: Iterable[Record]) -> set[str]:
        """Paths of other shards whose files have changed, and may belong to another shard now."""
        elsewhere = self.files.keys() - set(self.names)
        return {
            record.path
            for record in records
            if record.path in elsewhere
            and isinstance(content := self.contents.of(record.path), str)
            and content != record.content_hash
        }

    def _add(self, name: str, made: Plan) -> None:
        """Decide what must be done with one file."""
        content = self.contents.of(name)
        if isinstance(content, ShapeError):
            made.unreadable.append(failed(self._record(name), content))
            return
        identity = _identity(self.files[name], content)
        if name not in self._held and (old := self._gone.pop(identity, None)):
            made.moved[old.path] = name
            self._rename(old, name)
        earlier, stamp = self._held.get(name), self.contents.stamp(name)
        if earlier is not None and name in self._labels:
            made.labels[name] = self._labels[name]
        if earlier is not None and earlier.content_hash == content:
            if earlier.status == "done" or not self._retry_failed:
                if stamp:
                    made.stamps[name] = stamp
                made.held.append(
                    replace(earlier, label=self._labels.get(name, earlier.label))
                )
                return
        elif original := self._queued.get(identity) or self._original(identity):
            # The earlier result of a file stays in the catalogue until the original has been processed.
            is_there = original.status == "done" and identity not in self._queued
            if earlier is not None and (is_there or earlier.status == "failed"):
                made.removed.append(name)
            made.duplicates.append((name, original))
            return
        self._queued[identity] = record = replace(
            self._record(name), content_hash=content, stamp=stamp
        )
        made.process.append((self.files[name], record))

    def _record(self, name: str) -> Record:
        """The new record of a file, without its content hash."""
        earlier = self._held.get(name)
        label = self._labels.get(name) or (earlier.label if earlier else None)
        return Record(self._ids[name], name, "", label, versions=versions())

    def _rename(self, old: Record, name: str) -> None:
        """Give a renamed file its old record, with the old id and the label of this id."""
        record = replace(old, path=name)
        self._held[name] = record
        self._ids[name] = record.id
        same = self._same[_identity(ScanPath.parse(old.path), old.content_hash)]
        same[same.index(old)] = record
        if record.id in self._labels_left:
            self._labels.setdefault(name, self._labels_left.pop(record.id))

    def _original(self, identity: Identity) -> Record | None:
        """A record with this content; if its file is one of `files`, the file still has the content."""
        for record in self._same.get(identity, ()):
            content = (
                self.contents.of(record.path)
                if record.path in self.files
                else record.content_hash
            )
            if isinstance(content, ShapeError) or content == record.content_hash:
                return record
        return None


def _check_labels(
    matched: Mapping[str, str],
    unknown: Sequence[str],
    intake: Intake,
    names: Iterable[str],
    records: Sequence[Record],
) -> None:
    """Check that a label file names a scan, or an id that a renamed file may keep."""
    is_lost = (
        unknown and not matched and {record.id for record in records}.isdisjoint(unknown)
    )
    if is_lost and intake.label_file is not None:
        meant = did_you_mean(Path(unknown[0]).name, (Path(name).name for name in names))
        raise BenchmarkError(
            f"{intake.label_file} must name scans, but its {len(unknown)} names are not among them, such as "
            f"{unknown[0]!r}{meant}"
        )


def _identity(scan: ScanPath, content: str) -> Identity:
    """The identity of a scan: the suffix belongs to it, because it determines how the bytes are read."""
    return scan.suffix, content


def _is_gone(path: str) -> bool:
    """Whether there is no such file; false if that is unknown, as at a URL or without permission."""
    scan = ScanPath.parse(path)
    try:
        if scan.url is None:
            scan.file.stat()
    except (FileNotFoundError, NotADirectoryError):
        return True
    except OSError:
        pass
    return False


class Stamp(NamedTuple):
    """Fingerprint of a file and the parts that it names, and the time of its last change; seconds."""

    text: str
    changed: float


def stamp_of(file: ScanPath) -> Stamp | None:
    """The stamp of a file. Two equal stamps of a path, the first of them settled, are of one content.

    Every change of a file sets its ctime, which no user can set to another time. The number of the device is
    left out, because it may change when the computer starts, and differs between the computers of a cluster.
    """
    if file.url is not None:
        return None
    try:
        # Of the opened file, because a network file system may say what it knew of a file not opened.
        found = of_each_file(file.file, lambda opened: os.fstat(opened.fileno()))
    except ScanReadError:
        return None
    text = "; ".join(
        f"{one.st_size} {one.st_mtime_ns} {one.st_ctime_ns} {one.st_ino}" for one in found
    )
    return Stamp(text, max(max(one.st_mtime, one.st_ctime) for one in found))


class Contents:
    """Hashes of scans, computed in threads: in advance with `expect`, or on demand with `of`.

    Each file is read once. A file whose stamp is that of its record is not read. A thread that reads a file
    for more than `timeout` seconds, as on a network that is not connected, is not waited for any more.
    """

    def __init__(
        self,
        scans: Mapping[str, ScanPath],
        n_threads: int,
        timeout: float,
        records: Iterable[Record] = (),
    ) -> None:
        self._files = {name: scan.whole for name, scan in scans.items()}
        self._scans, self._timeout = scans, timeout
        self._records = {
            record.path: record
            for record in records
            if record.stamp and record.content_hash
        }
        self._stamps_of_records = self._by_file()
        self._turns = Semaphore(n_threads)
        self._is_closed = False
        # None: the file has not changed.
        self._hashes: dict[ScanPath, Future[str | None]] = {}
        self._stamps: dict[ScanPath, str] = {}

    def expect(self, names: Iterable[str]) -> None:
        """Begin to hash scans in the background."""
        for file in (self._files[name] for name in names):
            if file not in self._hashes:
                self._hashes[file] = Future()
                # A daemon thread, because a program waits for a pool of threads before it ends.
                Thread(target=self._read, args=(file,), daemon=True).start()

    def of(self, name: str) -> str | ShapeError:
        """The SHA-256 hash of a scan, or the error of reading its file."""
        self.expect([name])
        file = self._files[name]
        try:
            # So long for a turn, and so long for the file.
            content = self._hashes[file].result(2 * self._timeout)
        except ShapeError as error:
            return error
        except TimeoutError:
            message = f"{file} was not read within {self._timeout:g} s: raise --timeout"
            return StageTimeout(message, stage=Stage.READ)
        if content is None:
            return self._records[name].content_hash
        return scan_hash(self._scans[name], content)

    def stamp(self, name: str) -> str | None:
        """The stamp of a scan that `of` has hashed; None if it does not suffice to know the file again."""
        return self._stamps.get(self._files[name])

    def close(self) -> None:
        """Hash no more files."""
        self._is_closed = True

    def _by_file(self) -> dict[ScanPath, str]:
        """The stamps of the files whose scans all have a record with the same stamp."""
        found: dict[ScanPath, set[str | None]] = {}
        for name, file in self._files.items() if self._records else ():
            record = self._records.get(name)
            found.setdefault(file, set()).add(record.stamp if record else None)
        return {
            file: stamp
            for file, (stamp, *others) in found.items()
            if stamp and not others
        }

    def _read(self, file: ScanPath) -> None:
        # Without a turn too, when threads hang for so long.
        has_turn = self._turns.acquire(timeout=self._timeout)
        try:
            if not self._is_closed:
                self._hashes[file].set_result(self._hash(file))
        except Exception as error:  # noqa: BLE001  the row of this file
            self._hashes[file].set_exception(shape_error(error, Stage.READ))
        finally:
            if has_turn:
                self._turns.release()

    def _hash(self, file: ScanPath) -> str | None:
        now, stamp = time.time(), stamp_of(file)
        if stamp is not None and stamp.text == self._stamps_of_records.get(file):
            return None
        content = file_hash(file, partial(alone, file_hash, timeout=self._timeout))
        # A file that was written meanwhile has one of two stamps.
        if (
            stamp is not None
            and stamp.changed < now - SETTLED
            and stamp == stamp_of(file)
        ):
            self._stamps[file] = stamp.text
        return content
