"""Scans and what a catalogue holds → what is left to do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pcretrieve.catalogue import Record
from pcretrieve.errors import PcretrieveError, ShapeError, Stage
from pcretrieve.ingestion import work
from pcretrieve.ingestion.discover import content_hash, printable, shape_ids
from pcretrieve.ingestion.labels import match_labels

__all__ = ["Plan", "failed", "plan"]


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """What an ingest is to do; paths are printable, as catalogues store them.

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
    unknown_labels : tuple of str
        Names in the label file that stand for none of the scans.
    """

    moved: dict[str, str]
    removed: tuple[str, ...]
    labels: dict[str, str]
    held: tuple[Record, ...]
    duplicates: tuple[tuple[Path, Record], ...]
    process: tuple[tuple[Path, Record], ...]
    unreadable: tuple[Record, ...]
    unknown_labels: tuple[str, ...]


def plan(
    paths: Sequence[Path], records: Sequence[Record], labels: Mapping[str, str], *, retry_failed: bool = False
) -> Plan:
    """Decide what is to be done with each scan, and do none of it.

    Files are told apart by content. A file that was renamed keeps its record; one whose content changed is
    processed again.

    Parameters
    ----------
    paths : sequence of Path
    records : sequence of Record
        Everything that the catalogue holds.
    labels : mapping of name to class
    retry_failed : bool, default False
        Process scans again that failed before, with the same content.

    Raises
    ------
    BenchmarkError
        If a label stands for several scans, or a scan is given two classes.
    """
    files = {printable(path): path for path in paths}
    contents = {name: _content(path) for name, path in files.items()}
    moved = _moved(records, contents)
    held = {(here := moved.get(r.path, r.path)): replace(r, path=here) for r in records}
    ids = shape_ids(files, {record.id: record.path for record in held.values()})
    matched, unknown_labels = match_labels(labels, {ids[name]: name for name in files})

    known = {_identity(r.path, r.content_hash): r for r in held.values() if _is_current(r, contents)}
    removed, kept, duplicates, process, unreadable = [], [], [], [], []
    for name, path in files.items():
        content, earlier = contents[name], held.get(name)
        label = matched.get(ids[name]) or (earlier.label if earlier else None)
        record = Record(ids[name], name, "", label, versions=work.versions())
        if isinstance(content, ShapeError):
            unreadable.append(failed(record, content))
            continue
        if earlier is not None and earlier.content_hash == content:
            if earlier.status == "done" or not retry_failed:
                kept.append(replace(earlier, label=label))
                continue
        elif twin := known.get(_identity(name, content)):
            # The earlier content is gone, but what was made of it stays until its successor is finished.
            if earlier is not None and held.get(twin.path) is twin and twin.status == "done":
                removed.append(name)
            duplicates.append((path, twin))
            continue
        known[_identity(name, content)] = record = replace(record, content_hash=content)
        process.append((path, record))
    return Plan(
        moved=moved,
        removed=tuple(removed),
        labels={name: matched[ids[name]] for name in files if name in held and ids[name] in matched},
        held=tuple(kept),
        duplicates=tuple(duplicates),
        process=tuple(process),
        unreadable=tuple(unreadable),
        unknown_labels=tuple(unknown_labels),
    )


def failed(record: Record, error: PcretrieveError) -> Record:
    """The record of a shape that cannot be processed."""
    return replace(
        record,
        status="failed",
        stage=str(error.stage or Stage.WORKER),
        error=type(error).__name__,
        message=printable(error.message),
    )


def _identity(path: str, content: str) -> tuple[str, str]:
    """What two files share that are one scan: under another suffix the same bytes may mean another thing."""
    return Path(path).suffix.lower(), content


def _content(path: Path) -> str | ShapeError:
    try:
        return content_hash(path)
    except ShapeError as error:
        return error


def _is_current(record: Record, contents: Mapping[str, str | ShapeError]) -> bool:
    """Whether the record's file has, as far as can be seen, still the content that the record stands for."""
    content = contents.get(record.path, record.content_hash)
    return isinstance(content, ShapeError) or content == record.content_hash


def _moved(records: Sequence[Record], contents: Mapping[str, str | ShapeError]) -> dict[str, str]:
    """New paths of files that were renamed, by their old ones."""
    held = {record.path for record in records}
    gone = {
        _identity(record.path, record.content_hash): record.path
        for record in records
        if record.content_hash and record.path not in contents and _is_gone(record.path)
    }
    moved = {}
    for name, content in contents.items():
        if name in held or isinstance(content, ShapeError):
            continue
        if old := gone.pop(_identity(name, content), None):
            moved[old] = name
    return moved


def _is_gone(path: str) -> bool:
    try:
        Path(path).stat()
    except (FileNotFoundError, NotADirectoryError):
        return True
    except OSError:
        return False  # out of reach, a folder without permission for one
    return False
