"""Scans and the records of a catalogue → a plan: which scans must be processed, and which records changed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pcretrieve.catalogue import Catalogue, Record
from pcretrieve.errors import InputError, PcretrieveError, ShapeError, Stage
from pcretrieve.formats import split_member, url_of
from pcretrieve.ingestion.discover import printable, shape_ids
from pcretrieve.ingestion.labels import match_labels
from pcretrieve.ingestion.versions import versions

__all__ = ["Plan", "Planner", "apply", "failed", "failed_paths"]

Identity = tuple[str, str]  # suffix and SHA-256 of a file


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """What an ingest does with some files. Paths are printable, as catalogues store them.

    duplicates: tuple of (Path, Record), files with the same content as another file, and the record of the
        other file.
    process: tuple of (Path, Record), scans that must be processed, and their new records; the id may still
        change.
    """

    moved: dict[str, str]
    removed: tuple[str, ...]
    labels: dict[str, str]
    stamps: dict[str, str]
    held: tuple[Record, ...]
    duplicates: tuple[tuple[Path, Record], ...]
    process: tuple[tuple[Path, Record], ...]
    unreadable: tuple[Record, ...]


class Planner:
    """Decides what must be done with each scan, file by file, while the contents of the files are hashed.

    Files are identified by their content. A file that was renamed keeps its record. A file with new content
    is processed again. The planner writes nothing.
    """

    def __init__(
        self,
        files: Mapping[str, Path],
        records: Sequence[Record],
        labels: Mapping[str, str],
        content: Callable[[str], str | ShapeError],
        *,
        stamp: Callable[[str], str | None] = lambda name: None,
        retry_failed: bool = False,
    ) -> None:
        self.files = files
        self._stamp = stamp
        self._content = content
        self._retry_failed = retry_failed
        self._held = {record.path: record for record in records}
        self._ids = shape_ids(self.files, {record.id: record.path for record in records})
        matched, unknown = match_labels(labels, {self._ids[name]: name for name in self.files})
        self._labels = {name: matched[self._ids[name]] for name in self.files if self._ids[name] in matched}
        self._labels_left = {name: labels[name] for name in unknown}
        self._same: dict[Identity, list[Record]] = {}
        self._gone: dict[Identity, Record] = {}
        self._queued: dict[Identity, Record] = {}
        for record in records:
            if record.content_hash:
                identity = _identity(record.path, record.content_hash)
                self._same.setdefault(identity, []).append(record)
                if record.path not in self.files and _is_gone(record.path):
                    self._gone[identity] = record

    @property
    def unknown_labels(self) -> list[str]:
        """Names in the label file that match no scan, so far as files were planned."""
        return list(self._labels_left)

    def plan(self, names: Iterable[str]) -> Plan:
        """Decide what must be done with some of the files."""
        moved, labels, stamps = {}, {}, {}
        removed, held, duplicates, process, unreadable = [], [], [], [], []
        for name in names:
            content = self._content(name)
            if isinstance(content, ShapeError):
                unreadable.append(failed(self._record(name), content))
                continue
            identity = _identity(name, content)
            if name not in self._held and (old := self._gone.pop(identity, None)):
                moved[old.path] = name
                self._rename(old, name)
            earlier = self._held.get(name)
            if earlier is not None and name in self._labels:
                labels[name] = self._labels[name]
            if earlier is not None and earlier.content_hash == content:
                if earlier.status == "done" or not self._retry_failed:
                    if stamp := self._stamp(name):
                        stamps[name] = stamp
                    held.append(replace(earlier, label=self._labels.get(name, earlier.label)))
                    continue
            elif original := self._queued.get(identity) or self._original(identity):
                # The earlier result of a file stays in the catalogue until the original has been processed.
                if earlier is not None and original.status == "done" and identity not in self._queued:
                    removed.append(name)
                duplicates.append((self.files[name], original))
                continue
            self._queued[identity] = record = replace(
                self._record(name), content_hash=content, stamp=self._stamp(name)
            )
            process.append((self.files[name], record))
        return Plan(
            moved,
            tuple(removed),
            labels,
            stamps,
            tuple(held),
            tuple(duplicates),
            tuple(process),
            tuple(unreadable),
        )

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
        same = self._same[_identity(old.path, old.content_hash)]
        same[same.index(old)] = record
        if record.id in self._labels_left:
            self._labels.setdefault(name, self._labels_left.pop(record.id))

    def _original(self, identity: Identity) -> Record | None:
        """A record with this content; if its file is one of `files`, the file still has the content."""
        for record in self._same.get(identity, ()):
            content = self._content(record.path) if record.path in self.files else record.content_hash
            if isinstance(content, ShapeError) or content == record.content_hash:
                return record
        return None


def apply(made: Plan, catalogue: Catalogue) -> None:
    """Write the changes of a plan to the records of a catalogue."""
    if made.moved or made.removed or made.labels or made.stamps:
        catalogue.revise(moved=made.moved, removed=made.removed, labels=made.labels, stamps=made.stamps)


def failed(record: Record, error: PcretrieveError) -> Record:
    """Make a record of a failure."""
    return replace(
        record,
        status="failed",
        stage=str(error.stage or Stage.WORKER),
        error=type(error).__name__,
        message=printable(error.message),
    )


def failed_paths(catalogue: Catalogue, stage: str | None = None) -> list[Path]:
    """The scans of a catalogue that failed.

    Returns list of Path: the scans, in ascending order of id.
    """
    failures = catalogue.records(status="failed")
    paths = [Path(record.path) for record in failures if stage in (None, record.stage)]
    if not paths:
        stages = ", ".join(sorted({str(record.stage) for record in failures})) or "none"
        raise InputError(
            f"no shape of {catalogue.location} failed"
            + (f" in the stage {stage}; stages with failures: {stages}" if stage else "")
        )
    return paths


def _identity(path: str, content: str) -> Identity:
    """The identity of a scan: the suffix belongs to it, because it determines how the bytes are read."""
    file, _ = split_member(Path(path))
    return file.suffix.lower(), content


def _is_gone(path: str) -> bool:
    if url_of(Path(path)) is not None:
        return False  # unknown
    try:
        split_member(Path(path))[0].stat()
    except (FileNotFoundError, NotADirectoryError):
        return True
    except OSError:
        return False  # not accessible, for example in a folder without permission
    return False
