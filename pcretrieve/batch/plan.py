"""Scans and a catalogue → what is left to do."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from pcretrieve.batch import work
from pcretrieve.batch.discover import content_hash, printable, shape_ids
from pcretrieve.batch.labels import match_labels
from pcretrieve.catalogue import Catalogue, Record
from pcretrieve.errors import ShapeError

__all__ = ["Summary", "failed", "plan"]


@dataclass(slots=True)
class Summary:
    """What an ingest did.

    Attributes
    ----------
    done, failed : list of Record
        Processed now.
    held : list of Record
        Skipped: the catalogue has the same content already, done or failed, under that path, or under one
        that is gone since.
    duplicates : list of (Path, Record)
        Skipped: the same content under another path.
    unknown_labels : list of str
        Names in the label file that stand for none of the scans.
    """

    done: list[Record] = field(default_factory=list)
    failed: list[Record] = field(default_factory=list)
    held: list[Record] = field(default_factory=list)
    duplicates: list[tuple[Path, Record]] = field(default_factory=list)
    unknown_labels: list[str] = field(default_factory=list)


def plan(
    paths: Sequence[Path],
    catalogue: Catalogue,
    labels: Mapping[str, str],
    summary: Summary,
    *,
    retry_failed: bool,
    on_skip: Callable[[Record], None],
) -> list[tuple[Path, Record]]:
    """The scans that must be processed, with the records that they will get.

    Files are told apart by content. A file that was renamed keeps its record; one whose content changed is
    processed again. What is skipped goes into `summary`.

    Parameters
    ----------
    paths : sequence of Path
    catalogue : Catalogue
        Is given the new paths and labels of the scans that it holds.
    labels : mapping of name to class
    summary : Summary
    retry_failed : bool
        Process scans again that failed before, with the same content.
    on_skip : callable
        Called with each record that is skipped.

    Returns
    -------
    list of (Path, Record)
        The record of a file that cannot even be opened is a failed one already.
    """
    files = {printable(path): path for path in paths}
    contents = {name: _content(path) for name, path in files.items()}
    held = _followed(catalogue, contents)
    ids = shape_ids(files, {record.id: record.path for record in held.values()})
    matched, summary.unknown_labels = match_labels(labels, {ids[name]: name for name in files})
    catalogue.set_labels(matched)

    # A record whose file has other content by now stands for that content no more.
    current = [r for r in held.values() if contents.get(r.path, r.content_hash) == r.content_hash]
    known = {_identity(record.path, record.content_hash): record for record in current}
    queue = []
    for name, path in files.items():
        content, earlier = contents[name], held.get(name)
        label = matched.get(ids[name]) or (earlier.label if earlier else None)
        record = Record(ids[name], name, "", label, versions=work.versions())
        if isinstance(content, ShapeError):
            queue.append((path, failed(record, content)))
            continue
        if earlier is not None and earlier.content_hash == content:
            if earlier.status == "done" or not retry_failed:
                summary.held.append(replace(earlier, label=label))
                on_skip(earlier)
                continue
        elif twin := known.get(_identity(name, content)):
            if earlier is not None:
                catalogue.remove(earlier.id)
            summary.duplicates.append((path, twin))
            on_skip(twin)
            continue
        known[_identity(name, content)] = record = replace(record, content_hash=content)
        queue.append((path, record))
    return queue


def failed(record: Record, error: ShapeError) -> Record:
    """The record of a shape that cannot be processed."""
    return replace(
        record,
        status="failed",
        stage=error.stage or "unknown",
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


def _followed(catalogue: Catalogue, contents: Mapping[str, str | ShapeError]) -> dict[str, Record]:
    """The catalogue's records by path, those of renamed files by their new one."""
    held = {record.path: record for record in catalogue.records()}
    gone = {
        _identity(record.path, record.content_hash): record
        for record in held.values()
        if record.content_hash and record.path not in contents and _is_gone(record.path)
    }
    for name, content in contents.items():
        if name in held or isinstance(content, ShapeError):
            continue
        if record := gone.pop(_identity(name, content), None):
            catalogue.move(record.id, name)
            held[name] = replace(held.pop(record.path), path=name)
    return held


def _is_gone(path: str) -> bool:
    try:
        Path(path).stat()
    except (FileNotFoundError, NotADirectoryError):
        return True
    except OSError:
        return False  # out of reach, a folder without permission for one
    return False
