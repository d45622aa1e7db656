"""Many scans → catalogue, processed by an executor."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from pcretrieve.catalogue import Catalogue, Content, Record
from pcretrieve.errors import PcretrieveError
from pcretrieve.ingestion import work
from pcretrieve.ingestion.contents import Contents
from pcretrieve.ingestion.discover import printable
from pcretrieve.ingestion.executors import Executor
from pcretrieve.ingestion.isolation import in_processes
from pcretrieve.ingestion.plan import Plan, Planner, apply, failed
from pcretrieve.options import PipelineOptions

__all__ = ["Summary", "ingest_files"]

# Number of files that are planned together: large enough for few transactions, small enough to begin soon.
FILES_AT_ONCE = 32


@dataclass(slots=True)
class Summary:
    """The result of an ingest.

    Attributes
    ----------
    done : list of Record
        Scans that were processed.
    failed : list of Record
        Scans that failed. The catalogue keeps the result of an earlier run, if there is one.
    held : list of Record
        Skipped scans: the catalogue has the same content already, done or failed, with the same path or with
        the path of a file that does not exist any more.
    duplicates : list of (Path, Record)
        Skipped files with the same content as another file, and the record of the other file.
    unknown_labels : list of str
        Names in the label file that match no scan.
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
    executor: Executor = in_processes,
    retry_failed: bool = False,
    on_shape: Callable[[Record], None] = lambda record: None,
) -> Summary:
    """Process scans, and store the results, including failures.

    Each shape is stored as soon as it is finished, so that an interrupted run can be continued by starting it
    again.

    Parameters
    ----------
    paths : sequence of Path
        The scans, from `discover`.
    catalogue : Catalogue
        The catalogue, whose options are used.
    labels : mapping of str to str, optional
        Class by name, from `read_labels`. Labels are also applied to scans that the catalogue has already.
    workers : int, optional
        Largest number of scans that are processed at a time. By default one for each core.
    timeout : float, default 600
        Longest time for one shape; seconds.
    memory : float, optional
        Largest heap of one worker; GiB.
    executor : Executor, optional
        The executor that processes the scans. By default worker processes on this computer, so that a scan
        that hangs, crashes or exhausts the memory does not affect others.
    retry_failed : bool, default False
        Process scans again that failed before, with the same content and options.
    on_shape : callable, optional
        Called with each record, after it has been stored or skipped.

    Returns
    -------
    Summary
        The records of all scans, by what was done with them.

    Raises
    ------
    BenchmarkError
        If a label matches several scans, or a scan has two classes.
    CatalogueError
        If the catalogue cannot be written.
    PcretrieveError
        If the executor cannot work, or ends without an outcome for each scan.
    """
    summary = Summary()
    files = {printable(path): path for path in paths}
    contents = Contents(files, workers or len(os.sched_getaffinity(0)), timeout)
    planner = Planner(files, catalogue.records(), labels or {}, contents.of, retry_failed=retry_failed)

    def store(record: Record, content: Content | None) -> None:
        stored = catalogue.put(record, content)
        if content is None:
            stored = _reported(record, stored)
        (summary.failed if content is None else summary.done).append(stored)
        on_shape(stored)

    def queue() -> Iterator[tuple[Path, Record]]:
        """Yield the scans that must be processed; the results for other scans are stored."""
        for made in _plans(planner, contents):
            apply(made, catalogue)
            summary.held += made.held
            summary.duplicates += made.duplicates
            for record in (*made.held, *(original for _, original in made.duplicates)):
                on_shape(record)
            for record in made.unreadable:
                store(record, None)
            for scan in made.process:
                in_work.add(scan[0])
                yield scan

    in_work: set[Path] = set()
    running = executor(
        partial(_content, catalogue.options), queue(), workers=workers, timeout=timeout, memory=memory
    )
    with closing(contents), closing(running):
        for (path, record), outcome in running:
            in_work.discard(path)
            if isinstance(outcome, Content):
                store(replace(record, steps=outcome.shape.provenance), outcome)
            else:
                store(failed(record, outcome), None)
    if in_work:
        raise PcretrieveError(
            f"an executor must give an outcome for each scan, but {len(in_work)} have none, {min(in_work)} "
            "among them: start the ingest again, with another executor if necessary"
        )
    summary.unknown_labels = planner.unknown_labels
    return summary


def _plans(planner: Planner, contents: Contents) -> Iterator[Plan]:
    """Yield plans for some files at a time; meanwhile, the contents of the next files are hashed."""
    names = list(planner.files)
    chunks = [names[start : start + FILES_AT_ONCE] for start in range(0, len(names), FILES_AT_ONCE)]
    for chunk, upcoming in zip(chunks, [*chunks[1:], []], strict=True):
        contents.expect([*chunk, *upcoming])
        yield planner.plan(chunk)


def _reported(failure: Record, stored: Record) -> Record:
    """The record of a failure, with a note if the catalogue keeps an earlier result."""
    if stored.status == "failed":
        return stored
    kept = f"{failure.message}; the catalogue keeps what was made of this file on {stored.added}"
    return replace(failure, id=stored.id, message=kept)


def _content(options: PipelineOptions, scan: tuple[Path, Record]) -> Content:
    return work.content(scan[0], options)
