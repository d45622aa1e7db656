"""Scans and what a catalogue holds → what is left to do."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pcretrieve.catalogue import Catalogue, Record
from pcretrieve.errors import PcretrieveError, ShapeError, Stage
from pcretrieve.ingestion import work
from pcretrieve.ingestion.discover import printable, shape_ids
from pcretrieve.ingestion.labels import match_labels

__all__ = ["Plan", "Planner", "apply", "failed"]

Identity = tuple[str, str]  # suffix and SHA-256 of a file


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """What an ingest is to do with some files; paths are printable, as catalogues store them.

    Attributes
    ----------
    moved : dict of path to path
        New path of each file that was renamed, by its old one.
    removed : tuple of str
        Paths of shapes whose files have become copies of other scans.
    labels : dict of path to class
        Of shapes that the catalogue holds, by their new path.
    held : tuple of Record
        The catalogue has the same content already, done or failed, under that path, or under one that is
        gone since.
    duplicates : tuple of (Path, Record)
        The same content under another path.
    process : tuple of (Path, Record)
        Scans that must be processed, with the records that they will get; the id may still change.
    unreadable : tuple of Record
        Failed records of files that cannot even be opened.
    """

    moved: dict[str, str]
    removed: tuple[str, ...]
    labels: dict[str, str]
    held: tuple[Record, ...]
    duplicates: tuple[tuple[Path, Record], ...]
    process: tuple[tuple[Path, Record], ...]
    unreadable: tuple[Record, ...]


class Planner:
    """Decides what is to be done with each scan, as the contents of the files become known.

    Files are told apart by content. A file that was renamed keeps its record; one whose content changed is
    processed again. Nothing is written.

    Parameters
    ----------
    files : mapping of str to Path
        All scans by their printable paths.
    records : sequence of Record
        Everything that the catalogue holds.
    labels : mapping of name to class
    content : callable
        SHA-256 of a file of `files`, by its name there, or the error that reading it raised; the same answer
        each time.
    retry_failed : bool, default False
        Process scans again that failed before, with the same content.

    Raises
    ------
    BenchmarkError
        If a label stands for several scans, or a scan is given two classes.
    """

    def __init__(
        self,
        files: Mapping[str, Path],
        records: Sequence[Record],
        labels: Mapping[str, str],
        content: Callable[[str], str | ShapeError],
        *,
        retry_failed: bool = False,
    ) -> None:
        self.files = files
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
        """Names in the label file that stand for none of the scans, of those planned so far."""
        return list(self._labels_left)

    def plan(self, names: Iterable[str]) -> Plan:
        """Decide about some of the files, in the light of those of earlier calls.

        Parameters
        ----------
        names : iterable of str
            Keys of `files`, each in one call only.

        Returns
        -------
        Plan
        """
        moved, labels = {}, {}
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
                    held.append(replace(earlier, label=self._labels.get(name, earlier.label)))
                    continue
            elif twin := self._queued.get(identity) or self._twin(identity):
                # What was made of the file before stays until its successor is finished.
                if earlier is not None and twin.status == "done" and identity not in self._queued:
                    removed.append(name)
                duplicates.append((self.files[name], twin))
                continue
            self._queued[identity] = record = replace(self._record(name), content_hash=content)
            process.append((self.files[name], record))
        return Plan(
            moved, tuple(removed), labels, tuple(held), tuple(duplicates), tuple(process), tuple(unreadable)
        )

    def _record(self, name: str) -> Record:
        """The record that a file will get, its content aside."""
        earlier = self._held.get(name)
        label = self._labels.get(name) or (earlier.label if earlier else None)
        return Record(self._ids[name], name, "", label, versions=work.versions())

    def _rename(self, old: Record, name: str) -> None:
        """Let a file have the record of the one that it was, its id, and a label that names that id."""
        record = replace(old, path=name)
        self._held[name] = record
        self._ids[name] = record.id
        same = self._same[_identity(old.path, old.content_hash)]
        same[same.index(old)] = record
        if record.id in self._labels_left:
            self._labels.setdefault(name, self._labels_left.pop(record.id))

    def _twin(self, identity: Identity) -> Record | None:
        """A record whose file has, as far as can be seen, still the content that the record stands for."""
        for record in self._same.get(identity, ()):
            content = self._content(record.path) if record.path in self.files else record.content_hash
            if isinstance(content, ShapeError) or content == record.content_hash:
                return record
        return None


def apply(made: Plan, catalogue: Catalogue) -> None:
    """Write into a catalogue what a plan changes in the shapes that it holds."""
    if made.moved or made.removed or made.labels:
        catalogue.revise(moved=made.moved, removed=made.removed, labels=made.labels)


def failed(record: Record, error: PcretrieveError) -> Record:
    """The record of a shape that cannot be processed."""
    return replace(
        record,
        status="failed",
        stage=str(error.stage or Stage.WORKER),
        error=type(error).__name__,
        message=printable(error.message),
    )


def _identity(path: str, content: str) -> Identity:
    """What two files share that are one scan: under another suffix the same bytes may mean another thing."""
    return Path(path).suffix.lower(), content


def _is_gone(path: str) -> bool:
    try:
        Path(path).stat()
    except (FileNotFoundError, NotADirectoryError):
        return True
    except OSError:
        return False  # out of reach, a folder without permission for one
    return False
