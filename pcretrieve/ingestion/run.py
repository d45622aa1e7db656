"""Many scans → catalogue: those that it lacks are processed by an executor, and stored when finished."""

from __future__ import annotations

import logging
import math
import os
import statistics
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pcretrieve.catalogue import Catalogue, CatalogueLike, Content, Record
from pcretrieve.errors import InputError, PcretrieveError
from pcretrieve.formats import ScanPath
from pcretrieve.formats.identity import printable
from pcretrieve.ingestion.attempts import Attempt, Work, next_attempt
from pcretrieve.ingestion.discover import (
    Look,
    Remote,
    check_remote,
    discover,
    looked_into,
)
from pcretrieve.ingestion.plan import Intake, Plan, Planner, Processing, failed
from pcretrieve.ingestion.pool import (
    Executor,
    Worker,
    check_main,
    in_processes,
    remove_abandoned,
)
from pcretrieve.ingestion.progress import Progress
from pcretrieve.options import OptionsLike, PipelineOptions
from pcretrieve.pipeline import log_steps
from pcretrieve.values.base import UNIT_KEPT, UNIT_TAKEN, unit_note

logger = logging.getLogger(__name__)

# Of each file of a scan: inode, bytes, and time of the last change, nanoseconds.
State = tuple[tuple[int, int, int], ...]


@dataclass(slots=True)
class Summary:
    """The result of an ingest.

    Attributes
    ----------
    done, failed : list of Record
        The records of scans that were processed.
    held : list of Record
        Those of scans that the catalogue had already.
    duplicates : list of (str, Record)
        Skipped files with the same content as another file, and the record of the other file.
    unknown_labels : list of str
        Names in the label file that match no scan.
    planned : list of Record
        With ``dry_run``, the records of scans that would be processed.
    """

    done: list[Record] = field(default_factory=list)
    failed: list[Record] = field(default_factory=list)
    held: list[Record] = field(default_factory=list)
    duplicates: list[tuple[str, Record]] = field(default_factory=list)
    unknown_labels: list[str] = field(default_factory=list)
    planned: list[Record] = field(default_factory=list)

    def skip(self, made: Plan, on_shape: Callable[[Record], None]) -> None:
        """Add the scans of a plan that are skipped."""
        self.held += made.held
        self.duplicates += made.duplicates
        for record in (*made.held, *(original for _, original in made.duplicates)):
            on_shape(record)


def ingest(
    paths: str | Path | Sequence[str | Path],
    catalogue: CatalogueLike,
    *,
    labels: str | Path | Mapping[str, str] | None = None,
    options: OptionsLike = None,
    workers: int | None = None,
    timeout: float = 600.0,
    memory: float | None = None,
    executor: Executor = in_processes,
    retry_failed: bool = False,
    retries: int = 0,
    max_failures: int | None = None,
    dry_run: bool = False,
    shard: str | None = None,
    on_shape: Callable[[Record], None] = lambda record: None,
    on_start: Callable[[int], None] = lambda number: None,
) -> Summary:
    """Process scans, and store them in a catalogue, failures included.

    Scans that the catalogue has already are skipped. A script that calls this function needs the guard ``if
    __name__ == "__main__":``, because worker processes are spawned.

    Parameters
    ----------
    paths : str, Path, or a sequence of them
        Files, folders, globs, or manifests (``.txt``, ``.csv``).
    catalogue : Catalogue, str or Path
        The catalogue in which the shapes are stored. A file that does not exist is created.
    labels : str, Path or mapping, optional
        The classes: a CSV file with the columns ``file`` and ``class``, a ``.cla`` file of the Princeton
        Shape Benchmark, a mapping of names to classes, or the name of a layout: ``shrec11``,
        ``shrec14-real``, ``shrec14-synthetic``, ``faust``, ``tosca``, ``psb``, ``folders`` or ``csv``.
    options : OptionsLike, optional
        The options of a new catalogue. By default the options of an existing catalogue, or the defaults.
    workers : int, optional
        Largest number of scans that are processed at a time. By default one for each core.
    timeout : float, default 600
        Longest time for one shape; seconds.
    memory : float, optional
        Largest heap of one worker; GiB. By default there is no limit.
    executor : Executor, optional
        What processes the scans, such as a `DaskExecutor`. By default worker processes on this computer, so
        that a scan that hangs, crashes or exhausts the memory does not affect other scans.
    retry_failed : bool, default False
        Whether scans that failed before are processed again.
    retries : int, default 0
        Number of further attempts at a scan that fails, after all other scans: in a new process, then with
        cheaper settings, then by the other method of surface reconstruction. What was changed is in the
        provenance of the shape, in the step ``retry``.
    max_failures : int, optional
        Number of scans that may fail in this run before it stops. By default all of them.
    dry_run : bool, default False
        Whether nothing is processed and stored: the summary has what would be done.
    shard : str, optional
        ``I/N``: process the I-th of N parts of the scans only, each into a catalogue of its own, from which
        `merge_catalogues` makes the catalogue of all. The part of a scan depends on its content.
    on_shape : function, optional
        Called with the record of each shape as soon as it is stored, or skipped.
    on_start : function, optional
        Called with the number of scans before the first of them is processed.

    Returns
    -------
    Summary
        The records of all scans: done, failed and skipped.

    Raises
    ------
    InputError
        If a path does not exist, or names no scans.
    BenchmarkError
        If the labels cannot be read, or contradict each other.
    OptionError
        If there is no such option.
    CatalogueError
        If the catalogue was built with other options, or cannot be opened.
    PcretrieveError
        If `max_failures` scans have failed.
    """
    check_main()
    how = Processing(
        workers, timeout, memory, executor, retry_failed, retries, max_failures, on_shape
    )
    intake = Intake.found(paths, labels, catalogue, shard, how.limits)
    chosen = None if options is None else PipelineOptions.of(options)
    on_start(len(intake.part))
    if dry_run or _is_new(catalogue):
        # Checks the labels too, before a catalogue is made.
        planner = _planner(intake, catalogue, chosen, how)
        if dry_run:
            return _planned(planner, on_shape)
    with Catalogue.opened(catalogue, chosen, create=True) as store:
        return process_scans(intake, store, how)


def retry(
    catalogue: CatalogueLike,
    *,
    stage: str | None = None,
    workers: int | None = None,
    timeout: float = 600.0,
    memory: float | None = None,
    executor: Executor = in_processes,
    retries: int = 0,
    remote: Remote = False,
    on_shape: Callable[[Record], None] = lambda record: None,
    on_start: Callable[[int], None] = lambda number: None,
) -> Summary:
    """Process the failed shapes of a catalogue again.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The catalogue.
    stage : str, optional
        Only shapes that failed in this stage, such as ``surface``, or ``worker`` for those whose process
        ended or exceeded its time limit.
    remote : bool or function, default False
        Whether scans at URLs, which the catalogue names, are fetched: anyone who made it may have written any
        address. A function is given the hosts, and decides.
    workers, timeout, memory, executor, retries, on_shape, on_start : object, optional
        As for `pcretrieve.ingest`.

    Returns
    -------
    Summary
        The records of these shapes.

    Raises
    ------
    InputError
        If no shape failed in this stage, or a scan must be fetched from a URL, and may not be.
    CatalogueError
        If the catalogue cannot be opened.
    """
    how = Processing(workers, timeout, memory, executor, True, retries, None, on_shape)
    with Catalogue.opened(catalogue) as store:
        failures = store.records(status="failed")
        scans = [
            ScanPath.parse(record.path)
            for record in failures
            if stage in (None, record.stage)
        ]
        if not scans:
            stages = (
                ", ".join(sorted({str(record.stage) for record in failures})) or "none"
            )
            raise InputError(
                f"no shape of {store.location} failed"
                + (
                    f" in the stage {stage}; stages with failures: {stages}"
                    if stage
                    else ""
                )
            )
        check_remote(scans, remote, store.location)
        on_start(len(scans))
        return process_scans(Intake(scans, scans), store, how)


def watch(
    folder: str | Path,
    catalogue: CatalogueLike,
    *,
    options: OptionsLike = None,
    interval: float = 5.0,
    workers: int | None = None,
    timeout: float = 600.0,
    memory: float | None = None,
    executor: Executor = in_processes,
    retries: int = 0,
    on_shape: Callable[[Record], None] = lambda record: None,
) -> Iterator[Summary]:
    """Process the scans that are in a folder, and those that arrive, as soon as they stop growing.

    A file is processed when two looks have found it unchanged. One that changes afterwards is processed
    again, and replaces its earlier result.

    Parameters
    ----------
    folder : str or Path
        The folder, with its subfolders.
    catalogue : Catalogue, str or Path
        The catalogue in which the shapes are stored. A file that does not exist is created.
    options : OptionsLike, optional
        The options of a new catalogue. By default the options of an existing catalogue, or the defaults.
    interval : float, default 5
        Time between two looks into the folder; seconds.
    workers, timeout, memory, executor, retries, on_shape : object, optional
        As for `pcretrieve.ingest`.

    Yields
    ------
    Summary
        The records of the scans that have arrived together, after they were processed. There is no last one.

    Raises
    ------
    InputError
        If there is no such folder.
    OptionError
        If there is no such option.
    CatalogueError
        If the catalogue was built with other options, or cannot be opened or written.
    """
    chosen = None if options is None else PipelineOptions.of(options)
    how = Processing(
        workers, timeout, memory, executor, retries=retries, on_shape=on_shape
    )
    arrivals = Arrivals(Path(folder), how.limits)
    with closing(arrivals), Catalogue.opened(catalogue, chosen, create=True) as store:
        while True:
            if scans := discover(arrivals.look(), limits=how.limits):
                yield process_scans(Intake(scans, scans), store, how)
            else:
                time.sleep(interval)


def process_scans(intake: Intake, catalogue: Catalogue, how: Processing) -> Summary:
    """Process scans, those of a shard or all, and store each result, or failure, as soon as it is there."""
    remove_abandoned()  # also where nothing is left to do after a kill
    records = catalogue.rows.origins()
    planner = Planner(intake, records, how)
    with closing(planner.contents):
        if changed := planner.changed(records):
            catalogue.rows.revise(removed=changed)
        with Progress(catalogue, len(planner.names)) as counts:
            run = _Run(catalogue, how, counts)
            attempts: Iterable[Attempt] = run.queue(planner)
            while True:
                with closing(
                    how.executor(Work(catalogue.options), attempts, **how.limits)
                ) as outcomes:
                    for attempt, outcome in outcomes:
                        run.finish(attempt, outcome)
                if not run.later:
                    break
                # A new call of the executor, whose processes are started after the failures.
                attempts, run.later = run.later, []
    run.summary.unknown_labels = planner.unknown_labels
    _compare_sizes(run.summary.done, catalogue)
    return run.summary


def _compare_sizes(done: Sequence[Record], catalogue: Catalogue) -> None:
    """Warn of scans whose unit is probably not that of the catalogue."""
    areas = catalogue.rows.areas() if done else []
    usual = statistics.median_low(areas) if areas else 0.0
    found: dict[str, list[Record]] = {}
    notes = {
        note: record for record in done for step in record.steps for note in step.notes
    }
    for note, record in notes.items():
        if UNIT_KEPT in note or UNIT_TAKEN in note:
            logger.warning("%s: %s; perhaps further scans too", record.path, note)
    for record in done if usual else ():
        ratio = math.sqrt((record.area or 0) / usual)
        if said := ratio and unit_note(ratio, catalogue.options.scan.unit):
            found.setdefault(said, []).append(record)
    for said, records in found.items():
        logger.warning(
            "the size of %d scans, such as %s, is %s", len(records), records[0].path, said
        )


class _Run:
    """One ingest: what was stored and skipped so far, and the scans that are tried again later."""

    def __init__(self, catalogue: Catalogue, how: Processing, counts: Progress) -> None:
        self._catalogue, self._how, self._counts = catalogue, how, counts
        self.summary = Summary()
        self.later: list[Attempt] = []

    def queue(self, planner: Planner) -> Iterator[Attempt]:
        """Yield the scans that must be processed; the results for other scans are stored."""
        for made in planner.plans():
            made.apply(self._catalogue)
            self.summary.skip(made, self._how.on_shape)
            self._counts.skip(made.held, len(made.duplicates))
            for record in made.unreadable:
                self._store(record, None)
            for path, record in made.process:
                yield Attempt(path, record)

    def finish(self, attempt: Attempt, outcome: Content | PcretrieveError) -> None:
        """Store an outcome, or append the next attempt to `later`."""
        if isinstance(outcome, Content):
            steps = (*outcome.shape.provenance, *attempt.steps)
            self._store(replace(attempt.record, steps=steps), outcome)
            return
        options = self._catalogue.options
        upcoming = (
            next_attempt(attempt, outcome, options)
            if len(attempt.notes) < self._how.retries
            else None
        )
        if upcoming is None:
            self._store(
                replace(failed(attempt.record, outcome), steps=attempt.steps), None
            )
        else:
            logger.warning("%s: %s", attempt.path.name, printable(upcoming.notes[-1]))
            self.later.append(upcoming)

    def _store(self, record: Record, content: Content | None) -> None:
        stored = self._catalogue.put(record, content)
        if content is None and stored.status != "failed":
            kept = f"{record.message}; the catalogue keeps what was made of this file on {stored.added}"
            stored = replace(record, id=stored.id, message=kept)
        (self.summary.failed if content is None else self.summary.done).append(stored)
        log_steps(Path(stored.path).name, stored.steps)
        for other in (
            ()
            if content is None
            else self._catalogue.rows.with_content(stored.content_hash)
        ):
            if (
                other.path != stored.path
                and Path(other.path).suffix == Path(stored.path).suffix
            ):
                logger.warning(
                    "%s and %s, of another ingest, are the same scan",
                    stored.path,
                    other.path,
                )
        if content is None:
            logger.info("failed: [%s / %s] %s", stored.id, stored.stage, stored.message)
        self._counts.add(stored)
        self._how.on_shape(stored)
        if content is None and len(self.summary.failed) == self._how.max_failures:
            raise PcretrieveError(
                f"stopped after {self._how.max_failures} scans that failed, which is the limit "
                "(--max-failures); look at the reasons, and start the ingest again: it goes on with the "
                "other scans"
            )


def _is_new(catalogue: CatalogueLike) -> bool:
    """Whether there is no file of a catalogue yet, or the empty one that each begins as."""
    if isinstance(catalogue, Catalogue) or "://" in str(catalogue):
        return False
    path = Path(catalogue)
    return not path.exists() or not path.stat().st_size


def _planner(
    intake: Intake,
    catalogue: CatalogueLike,
    options: PipelineOptions | None,
    how: Processing,
) -> Planner:
    """The planner of an ingest into a catalogue, which is not made if there is none."""
    if _is_new(catalogue):
        return Planner(intake, [], how)
    with Catalogue.opened(catalogue, options) as store:
        return Planner(intake, store.records(), how)


def _planned(planner: Planner, on_shape: Callable[[Record], None]) -> Summary:
    """What an ingest would do; nothing is written."""
    summary = Summary()
    with closing(planner.contents):
        for made in planner.plans():
            summary.skip(made, on_shape)
            summary.failed += made.unreadable
            summary.planned += (record for _, record in made.process)
            for record in (*made.unreadable, *(record for _, record in made.process)):
                on_shape(record)
    summary.unknown_labels = planner.unknown_labels
    return summary


class Arrivals:
    """Looks into a folder, and finds the files that have not changed since the last look.

    The kernel (inotify) does not report what other computers write to a network file system.
    """

    def __init__(self, folder: Path, limits: Mapping[str, Any] | None = None) -> None:
        if not folder.is_dir():
            raise InputError(
                f"there is no folder {folder} to watch: make it, or name another"
            )
        self._folder = folder.absolute()
        self._limits = limits
        self._idle: list[Worker[ScanPath, Look]] = []
        self._seen: dict[Path, State] = {}
        self._given: dict[Path, State] = {}

    def look(self) -> list[Path]:
        """Find the files of scans that are unchanged since the last look, and changed since they were found.

        A scan of several files is found when all its views are there.
        """
        now: dict[Path, State] = {}
        owned: set[Path] = set()
        files = [
            ScanPath.parse(Path(place, name))
            for place, _, names in os.walk(self._folder)
            for name in names
            if not name.startswith(".")
        ]
        for scan, look in looked_into(files, self._limits, self._idle).items():
            if look.is_scan:
                owned.update(part.path for part in look.parts)
                needed = (
                    part.path
                    for part in look.parts
                    if part.pose is not None or part.path.exists()
                )
                with suppress(
                    OSError
                ):  # it has vanished meanwhile, or a view is not there yet
                    states = (file.stat() for file in (scan.file, *needed))
                    now[scan.file] = tuple(
                        (one.st_ino, one.st_size, one.st_mtime_ns) for one in states
                    )
        found = [
            path
            for path, state in now.items()
            if self._seen.get(path) == state != self._given.get(path)
        ]
        self._seen = now
        self._given |= {path: now[path] for path in found}
        return sorted({*found} - owned)

    def close(self) -> None:
        """End the processes that look into files."""
        for worker in self._idle:
            worker.stop()
