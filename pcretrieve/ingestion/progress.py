"""The counts of the last ingest, which can be read at any time.

They are a setting of the catalogue, and name the process that counts: whether it is still there tells an
ingest that runs from one that was killed.
"""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, Field, NonNegativeInt

from pcretrieve.catalogue import Catalogue, CatalogueLike, Record
from pcretrieve.catalogue.records import repeated
from pcretrieve.errors import CatalogueError

State = Literal["none", "running", "finished", "stopped", "killed"]

# Shortest time between two writes, and the longest one after which an ingest of another computer, or of a
# container, is said to be running; seconds.
INTERVAL = 1.0
SILENCE = 3600.0

# The setting that has the counts, and what they say of the process that counts.
SETTING = "batch"
PROCESS = {"computer", "pid", "born"}

# Up to the largest time that can be written as a date, at the end of the year 9999.
Seconds = Annotated[float, Field(ge=0, le=253_402_300_799)]


@dataclass(frozen=True, slots=True)
class BatchStatus:
    """How far the last ingest into a catalogue is, and what the catalogue has.

    Attributes
    ----------
    state : "none", "running", "finished", "stopped" or "killed"
        That of the last ingest.
    started, updated : str or None
        Times of its first and of its last count, in ISO 8601.
    n_scans, n_done, n_failed, n_known, n_duplicates : int
        Numbers of its scans: all of them, and those that were done, failed now or before, are known already,
        or have the content of another file.
    scans_per_second : float
        Scans done or failed; 1/s.
    seconds_left : float or None
        Expected time to its end, if it is running; seconds.
    stages : dict of str to float
        Share of each stage in the time of the stages.
    failures : dict of str to int
        Failed shapes of the catalogue by error and stage.
    n_shapes : int
        Shapes of the catalogue with a signature.
    """

    state: State
    started: str | None
    updated: str | None
    n_scans: int
    n_done: int
    n_failed: int
    n_known: int
    n_duplicates: int
    scans_per_second: float
    seconds_left: float | None
    stages: dict[str, float]
    failures: dict[str, int]
    n_shapes: int


class _Counts(BaseModel):
    """The counts of one ingest; times in seconds since 1970, `stages` in seconds."""

    state: State = "running"
    started: Seconds = 0.0
    updated: Seconds = 0.0
    n_scans: NonNegativeInt = 0
    n_done: NonNegativeInt = 0
    n_failed: NonNegativeInt = 0
    n_known: NonNegativeInt = 0
    n_duplicates: NonNegativeInt = 0
    n_processed: NonNegativeInt = 0
    stages: dict[str, Seconds] = {}
    computer: str = ""
    pid: NonNegativeInt = 0
    born: str = ""


def status(catalogue: CatalogueLike) -> BatchStatus:
    """How far the last ingest into a catalogue is, which may be running, and what has failed.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The catalogue.

    Returns
    -------
    BatchStatus
        Rate, remaining time, share of each stage, and failures by kind.

    Raises
    ------
    CatalogueError
        If the catalogue cannot be opened.
    """
    with Catalogue.opened(catalogue) as store:
        counts = _stored(store)
        kinds = Counter(
            {
                f"{error} in {stage}": n
                for (stage, error), n in store.rows.failures().items()
            }
        )
        n_shapes = len(store)
    is_running = counts.state == "running" and _is_running(counts)
    seconds = (time.time() if is_running else counts.updated) - counts.started
    rate = counts.n_processed / seconds if seconds > 0 else 0.0
    n_finished = counts.n_done + counts.n_failed + counts.n_known + counts.n_duplicates
    total = sum(counts.stages.values())
    return BatchStatus(
        **counts.model_dump(
            exclude={"state", "started", "updated", "stages", "n_processed", *PROCESS}
        ),
        state="killed" if counts.state == "running" and not is_running else counts.state,
        started=_iso(counts.started),
        updated=_iso(counts.updated),
        scans_per_second=rate,
        seconds_left=(counts.n_scans - n_finished) / rate
        if is_running and rate > 0
        else None,
        stages={name: share / total for name, share in counts.stages.items()}
        if total
        else {},
        failures=dict(kinds.most_common()),
        n_shapes=n_shapes,
    )


class Progress:
    """The counts of a running ingest in its catalogue, until a later ingest counts there."""

    def __init__(self, catalogue: Catalogue, n_scans: int) -> None:
        pid = os.getpid()
        process = {"computer": _computer(), "pid": pid, "born": _born(pid)}
        self._counts = _Counts.model_validate(
            {"started": time.time(), "n_scans": n_scans, **process}
        )
        self._catalogue = catalogue
        self._written = 0.0

    def __enter__(self) -> Progress:
        self._write(is_first=True)
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._counts.state = "finished" if kind is None else "stopped"
        if kind is not None:
            self._catalogue.rows.answer_at_once()
        self._write()

    def skip(self, held: Sequence[Record], n_duplicates: int) -> None:
        """Count scans that the catalogue has already, as done or as failed, and copies of other scans."""
        n_failed = sum(record.status == "failed" for record in held)
        self._counts.n_failed += n_failed
        self._counts.n_known += len(held) - n_failed
        self._counts.n_duplicates += n_duplicates
        self._write(INTERVAL)

    def add(self, record: Record) -> None:
        """Count a scan that was processed, or that failed."""
        self._counts.n_processed += 1
        if record.status == "failed":
            self._counts.n_failed += 1
        else:
            self._counts.n_done += 1
            for step in record.steps:
                self._counts.stages[step.stage] = (
                    self._counts.stages.get(step.stage, 0.0) + step.seconds
                )
        self._write(INTERVAL)

    def _write(self, interval: float = 0.0, *, is_first: bool = False) -> None:
        """Write the counts, unless they were written less than an interval ago."""
        if time.monotonic() - self._written < interval:
            return
        self._written = time.monotonic()
        self._counts.updated = time.time()
        with suppress(CatalogueError):  # a full disk is the concern of the next shape
            self._keep(is_first)

    @repeated
    def _keep(self, is_first: bool) -> None:
        with self._catalogue.rows.database.writing():
            if is_first or _stored(self._catalogue).started == self._counts.started:
                self._catalogue.rows.keep_setting(SETTING, self._counts.model_dump_json())


def _stored(catalogue: Catalogue) -> _Counts:
    """The counts in a catalogue; those of no ingest if there are none."""
    try:
        return _Counts.model_validate_json(catalogue.rows.settings()[SETTING])
    except (KeyError, ValueError):
        return _Counts(state="none")


def _is_running(counts: _Counts) -> bool:
    if counts.computer and counts.computer == _computer():
        return counts.born == _born(counts.pid)
    return time.time() < counts.updated + SILENCE


def _computer() -> str:
    """A name of this computer since its start, and of the container that numbers the processes."""
    with suppress(OSError):
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii")
        return f"{boot.strip()} {Path('/proc/self/ns/pid').readlink()}"
    return ""


def _born(pid: int) -> str:
    """When a process of this computer was started, in ticks; empty if it has ended."""
    with suppress(OSError):
        state, *facts = (
            Path(f"/proc/{pid}/stat")
            .read_text("utf-8", "replace")
            .rpartition(")")[2]
            .split()
        )
        return "" if state in "ZX" else facts[18]
    return ""


def _iso(seconds: float) -> str | None:
    return (
        datetime.fromtimestamp(seconds, timezone.utc).isoformat(timespec="seconds")
        if seconds
        else None
    )
