"""The counts of the last ingest, which can be read at any time.

They are in a hidden file beside the catalogue, ``.bodies.sqlite.batch``, or in the cache folder of the user
if the catalogue is no file. It is one page, which is written by one call: it can be read at any moment. The
ingest holds a lock on it, which the system releases when the process ends.
"""

from __future__ import annotations

import fcntl
import hashlib
import logging
import os
import time
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, Field, NonNegativeInt

from pcretrieve.catalogue import CatalogueLike, Record, opened

logger = logging.getLogger(__name__)

State = Literal["none", "running", "finished", "stopped", "killed"]

PAGE = 4096  # bytes

# Shortest time between two writes; seconds.
INTERVAL = 1.0

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
    n_scans, n_done, n_failed, n_skipped : int
        Numbers of its scans.
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
    n_skipped: int
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
    n_skipped: NonNegativeInt = 0
    stages: dict[str, Seconds] = {}


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
    with opened(catalogue) as store:
        counts = _read(_path(store.location))
        kinds = Counter({f"{error} in {stage}": n for (stage, error), n in store.failures().items()})
        n_shapes = len(store)
    n_finished, is_running = counts.n_done + counts.n_failed, counts.state == "running"
    seconds = (time.time() if is_running else counts.updated) - counts.started
    rate = n_finished / seconds if seconds > 0 else 0.0
    n_left = counts.n_scans - counts.n_skipped - n_finished
    total = sum(counts.stages.values())
    return BatchStatus(
        **counts.model_dump(exclude={"started", "updated", "stages"}),
        started=_iso(counts.started),
        updated=_iso(counts.updated),
        scans_per_second=rate,
        seconds_left=n_left / rate if is_running and rate > 0 else None,
        stages={name: share / total for name, share in counts.stages.items()} if total else {},
        failures=dict(kinds.most_common()),
        n_shapes=n_shapes,
    )


class CountsFile:
    """The open file of a running ingest; without effect if another ingest has it, or it cannot be written."""

    def __init__(self, location: str, n_scans: int) -> None:
        now = time.time()
        self._counts = _Counts(started=now, updated=now, n_scans=n_scans)
        self._path = _path(location)
        self._descriptor: int | None = None
        self._written = 0.0

    def __enter__(self) -> CountsFile:
        descriptor = None
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o666)
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:  # also if another ingest has locked it
            logger.info("the progress of the ingest is not written to %s: %s", self._path, error.strerror)
            if descriptor is not None:
                os.close(descriptor)
        else:
            self._descriptor = descriptor
            self._write()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._counts.state = "finished" if kind is None else "stopped"
        self._write()
        if self._descriptor is not None:
            os.close(self._descriptor)

    def skip(self, n: int) -> None:
        """Count scans that the catalogue has already."""
        self._counts.n_skipped += n
        self._write(INTERVAL)

    def add(self, record: Record) -> None:
        """Count a scan that was processed, or that failed."""
        if record.status == "failed":
            self._counts.n_failed += 1
        else:
            self._counts.n_done += 1
            for step in record.steps:
                self._counts.stages[step.stage] = self._counts.stages.get(step.stage, 0.0) + step.seconds
        self._write(INTERVAL)

    def _write(self, interval: float = 0.0) -> None:
        """Write the counts, unless they were written less than an interval ago."""
        if self._descriptor is None or time.monotonic() - self._written < interval:
            return
        self._written = time.monotonic()
        self._counts.updated = time.time()
        data = self._counts.model_dump_json().encode().ljust(PAGE)
        with suppress(OSError):  # a full disk is the concern of the catalogue
            os.pwrite(self._descriptor, data, 0)
            os.ftruncate(self._descriptor, len(data))


def _read(path: Path) -> _Counts:
    """The counts in a file; those of no ingest if there is none."""
    try:
        with path.open("rb") as file:
            counts = _Counts.model_validate_json(file.read())
            try:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                counts.state = "running"
            else:
                counts.state = "killed" if counts.state == "running" else counts.state
            return counts
    except (OSError, ValueError):
        return _Counts(state="none")


def _path(location: str) -> Path:
    if "://" not in location:
        return Path(location).with_name(f".{Path(location).name}.batch")
    try:
        cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    except RuntimeError:  # there is no user
        cache = Path(os.devnull)
    return cache / "pcretrieve" / f"{hashlib.sha256(location.encode()).hexdigest()[:16]}.batch"


def _iso(seconds: float) -> str | None:
    return datetime.fromtimestamp(seconds, timezone.utc).isoformat(timespec="seconds") if seconds else None
