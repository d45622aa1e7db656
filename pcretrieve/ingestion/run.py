"""Many scans → catalogue, processed by an executor."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from pcretrieve.catalogue import Catalogue, Content, Record
from pcretrieve.errors import PcretrieveError
from pcretrieve.ingestion import work
from pcretrieve.ingestion.attempts import Attempt, next_attempt
from pcretrieve.ingestion.batch import written_down
from pcretrieve.ingestion.contents import Contents
from pcretrieve.ingestion.discover import printable
from pcretrieve.ingestion.executors import Executor
from pcretrieve.ingestion.isolation import in_processes
from pcretrieve.ingestion.plan import Plan, Planner, apply, failed
from pcretrieve.ingestion.temporary import remove_abandoned
from pcretrieve.options import PipelineOptions
from pcretrieve.pipeline.progress import log_steps, scan_name

__all__ = ["Summary", "ingest_files", "plan_files"]

logger = logging.getLogger(__name__)

# Number of files that are planned together: large enough for few transactions, small enough to begin soon.
FILES_AT_ONCE = 32


@dataclass(slots=True)
class Summary:
    """The result of an ingest.

    duplicates: list of (Path, Record), skipped files with the same content as another file, and the record of
        the other file.
    """

    done: list[Record] = field(default_factory=list)
    failed: list[Record] = field(default_factory=list)
    held: list[Record] = field(default_factory=list)
    duplicates: list[tuple[Path, Record]] = field(default_factory=list)
    unknown_labels: list[str] = field(default_factory=list)
    planned: list[Record] = field(default_factory=list)


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
    retries: int = 0,
    max_failures: int | None = None,
    only: Collection[Path] | None = None,
    on_shape: Callable[[Record], None] = lambda record: None,
) -> Summary:
    """Process scans, and store the results, including failures.

    Each shape is stored as soon as it is finished, so that an interrupted run can be continued by starting it
    again.

    timeout: longest time for one shape; seconds.
    """
    remove_abandoned()  # also where nothing is left to do after a kill
    summary = Summary()
    files = {printable(path): path for path in paths}
    records = catalogue.outlines()
    contents = Contents(files, workers or len(os.sched_getaffinity(0)), timeout, records)
    planner = Planner(
        files, records, labels or {}, contents.of, stamp=contents.stamp, retry_failed=retry_failed
    )
    names = _names_of(only, files)
    elsewhere = files.keys() - set(names)
    # Shapes of other shards stay, unless their files have changed since, and belong to another shard now.
    left = {record.path: record.content_hash for record in records if record.path in elsewhere}
    now = {path: contents.of(path) for path in left}
    if stale := {path for path, content in now.items() if content != left[path] and isinstance(content, str)}:
        catalogue.revise(removed=stale)

    def store(record: Record, content: Content | None) -> None:
        stored = catalogue.put(record, content)
        if content is None:
            stored = _reported(record, stored)
        (summary.failed if content is None else summary.done).append(stored)
        log_steps(scan_name(stored.path), stored.steps)
        if content is None:
            logger.info("failed: [%s / %s] %s", stored.id, stored.stage, stored.message)
        progress.batch.add(stored)
        progress.write()
        on_shape(stored)
        if content is None and len(summary.failed) == max_failures:
            raise PcretrieveError(
                f"stopped after {max_failures} scans that failed, which is the limit (--max-failures); look "
                "at the reasons, and start the ingest again: it goes on with the other scans"
            )

    def queue() -> Iterator[Attempt]:
        """Yield the scans that must be processed; the results for other scans are stored."""
        for made in _plans(names, planner, contents):
            apply(made, catalogue)
            _note(summary, _completed(made, catalogue), on_shape)
            progress.batch.n_skipped += len(made.held) + len(made.duplicates)
            progress.write()
            for record in made.unreadable:
                store(record, None)
            for path, record in made.process:
                yield Attempt(path, record)

    def finish(attempt: Attempt, outcome: Content | PcretrieveError) -> None:
        """Store an outcome, or append the next attempt to `later`."""
        if isinstance(outcome, Content):
            steps = (*outcome.shape.provenance, *attempt.steps)
            store(replace(attempt.record, steps=steps), outcome)
        elif len(attempt.notes) < retries and (upcoming := next_attempt(attempt, outcome, catalogue.options)):
            logger.warning("%s: %s", scan_name(attempt.path), printable(upcoming.notes[-1]))
            later.append(upcoming)
        else:
            store(replace(failed(attempt.record, outcome), steps=attempt.steps), None)

    later: list[Attempt] = []
    attempts: Iterable[Attempt] = queue()
    with closing(contents), written_down(catalogue.location, len(names), workers) as progress:
        while True:
            in_work: set[Path] = set()
            running = executor(
                partial(_content, catalogue.options),
                _counted(attempts, in_work),
                workers=workers,
                timeout=timeout,
                memory=memory,
            )
            with closing(running):
                for attempt, outcome in running:
                    in_work.discard(attempt.path)
                    finish(attempt, outcome)
            if in_work:
                raise PcretrieveError(
                    f"an executor must give an outcome for each scan, but {len(in_work)} have none, "
                    f"{min(in_work)} among them: start the ingest again, with another executor if necessary"
                )
            if not later:
                break
            # A new call of the executor, whose processes are started after the failures.
            attempts, later = later, []
    summary.unknown_labels = planner.unknown_labels
    return summary


def plan_files(
    paths: Sequence[Path],
    records: Sequence[Record],
    *,
    labels: Mapping[str, str] | None = None,
    timeout: float = 600.0,
    retry_failed: bool = False,
    only: Collection[Path] | None = None,
    on_shape: Callable[[Record], None] = lambda record: None,
) -> Summary:
    """Find what `ingest_files` would do, and write nothing.

    timeout: longest time to read one file; seconds.
    """
    remove_abandoned()  # also where nothing is left to do after a kill
    summary = Summary()
    files = {printable(path): path for path in paths}
    names = _names_of(only, files)
    contents = Contents(files, len(os.sched_getaffinity(0)), timeout, records)
    planner = Planner(files, records, labels or {}, contents.of, retry_failed=retry_failed)
    with closing(contents):
        for made in _plans(names, planner, contents):
            _note(summary, made, on_shape)
            summary.failed += made.unreadable
            summary.planned += (record for _, record in made.process)
            for record in (*made.unreadable, *(record for _, record in made.process)):
                on_shape(record)
    summary.unknown_labels = planner.unknown_labels
    return summary


def _names_of(only: Collection[Path] | None, files: Mapping[str, Path]) -> list[str]:
    """The names of the files that are processed."""
    chosen = {*files.values()} if only is None else {*only}
    return [name for name, path in files.items() if path in chosen]


def _note(summary: Summary, made: Plan, on_shape: Callable[[Record], None]) -> None:
    """Add the scans of a plan that are skipped to the summary."""
    summary.held += made.held
    summary.duplicates += made.duplicates
    for record in (*made.held, *(original for _, original in made.duplicates)):
        on_shape(record)


def _completed(made: Plan, catalogue: Catalogue) -> Plan:
    """A plan that was applied, with the provenance of the records that the catalogue has."""
    originals = [original for _, original in made.duplicates]
    stored = catalogue.several({record.id for record in (*made.held, *originals)})
    # An original that is still to be processed has a new content, and no provenance.
    whole = {(record.path, record.content_hash): record for record in stored}

    def completed(record: Record) -> Record:
        return whole.get((record.path, record.content_hash), record)

    return replace(
        made,
        held=tuple(map(completed, made.held)),
        duplicates=tuple((path, completed(original)) for path, original in made.duplicates),
    )


def _counted(attempts: Iterable[Attempt], in_work: set[Path]) -> Iterator[Attempt]:
    """The attempts; the path of each one that has been read is added to `in_work`."""
    for attempt in attempts:
        in_work.add(attempt.path)
        yield attempt


def _plans(names: Sequence[str], planner: Planner, contents: Contents) -> Iterator[Plan]:
    """Yield plans for some files at a time; meanwhile, the contents of the next files are hashed."""
    for start in range(0, len(names), FILES_AT_ONCE):
        contents.expect(names[start : start + 2 * FILES_AT_ONCE])
        yield planner.plan(names[start : start + FILES_AT_ONCE])


def _reported(failure: Record, stored: Record) -> Record:
    """The record of a failure, with a note if the catalogue keeps an earlier result."""
    if stored.status == "failed":
        return stored
    kept = f"{failure.message}; the catalogue keeps what was made of this file on {stored.added}"
    return replace(failure, id=stored.id, message=kept)


def _content(options: PipelineOptions, attempt: Attempt) -> Content:
    return work.content(attempt.path, options.changed(**attempt.changes))
