"""Many scans → catalogue, over isolated workers."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from pcretrieve.catalogue import Catalogue, Content, Record
from pcretrieve.ingestion import work
from pcretrieve.ingestion.contents import Contents
from pcretrieve.ingestion.discover import printable
from pcretrieve.ingestion.isolation import Isolation
from pcretrieve.ingestion.plan import Plan, Planner, apply, failed
from pcretrieve.options import PipelineOptions

__all__ = ["Summary", "ingest_files"]

# Files that are planned together: enough for few transactions, few enough that work begins at once.
FILES_AT_ONCE = 32


@dataclass(slots=True)
class Summary:
    """What an ingest did.

    Attributes
    ----------
    done : list of Record
        Processed now.
    failed : list of Record
        Failed now. A shape that finished in an earlier run keeps its place in the catalogue.
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


def ingest_files(
    paths: Sequence[Path],
    catalogue: Catalogue,
    *,
    labels: Mapping[str, str] | None = None,
    workers: int | None = None,
    timeout: float = 600.0,
    memory: float | None = None,
    retry_failed: bool = False,
    on_shape: Callable[[Record], None] = lambda record: None,
) -> Summary:
    """Process scans and store them, failures included.

    Shapes are processed in worker processes, so that one that hangs, crashes or fills the memory takes no
    other with it; what is finished is stored at once, so that an interrupted run can be started again and
    goes on.

    Parameters
    ----------
    paths : sequence of Path
        As from `discover`.
    catalogue : Catalogue
    labels : mapping of name to class, optional
        As from `read_labels`. Also applied to scans that the catalogue holds already.
    workers : int, optional
        Processes; by default one for each core.
    timeout : float, default 600
        Longest time for one shape; seconds.
    memory : float, optional
        Largest heap of one worker; GiB.
    retry_failed : bool, default False
        Process scans again that failed before, with the same content and options.
    on_shape : callable, optional
        Called with each record once it is stored, and with those skipped.
    """
    summary = Summary()
    files = {printable(path): path for path in paths}
    workers = workers or len(os.sched_getaffinity(0))
    contents = Contents(files, workers)
    planner = Planner(files, catalogue.records(), labels or {}, contents.of, retry_failed=retry_failed)

    def store(record: Record, content: Content | None) -> None:
        stored = catalogue.put(record, content)
        if content is None:
            stored = _reported(record, stored)
        (summary.failed if content is None else summary.done).append(stored)
        on_shape(stored)

    def queue() -> Iterator[tuple[Path, Record]]:
        """The scans to process; the others are dealt with on the way."""
        for made in _plans(planner, contents):
            apply(made, catalogue)
            summary.held += made.held
            summary.duplicates += made.duplicates
            for record in (*made.held, *(twin for _, twin in made.duplicates)):
                on_shape(record)
            for record in made.unreadable:
                store(record, None)
            yield from made.process

    running = Isolation(timeout, memory).each(partial(_content, catalogue.options), queue(), workers=workers)
    with closing(contents), closing(running):
        for (_, record), outcome in running:
            if isinstance(outcome, Content):
                store(replace(record, steps=outcome.shape.provenance), outcome)
            else:
                store(failed(record, outcome), None)
    summary.unknown_labels = planner.unknown_labels
    return summary


def _plans(planner: Planner, contents: Contents) -> Iterator[Plan]:
    """What to do, some files at a time: while they are processed, the contents of the next are hashed."""
    names = list(planner.files)
    chunks = [names[start : start + FILES_AT_ONCE] for start in range(0, len(names), FILES_AT_ONCE)]
    for chunk, upcoming in zip(chunks, [*chunks[1:], []], strict=True):
        contents.expect([*chunk, *upcoming])
        yield planner.plan(chunk)


def _reported(failure: Record, stored: Record) -> Record:
    """A failure as it is reported, which says where the catalogue keeps an earlier result instead."""
    if stored.status == "failed":
        return stored
    kept = f"{failure.message}; the catalogue keeps what was made of this file on {stored.added}"
    return replace(failure, id=stored.id, message=kept)


def _content(options: PipelineOptions, scan: tuple[Path, Record]) -> Content:
    return work.content(scan[0], options)
