"""What an ingest writes down about itself while it works, and what can be read from that at any time.

A hidden file beside the catalogue, ``.bodies.sqlite.batch``, or a file in the cache folder of the user if the
catalogue is no file, has the counts of the last ingest. It is one page, which is written by one call, so that
it can be read at any moment and survives the death of the ingest. The ingest holds a lock on it, which the
system releases when the process ends, however that happens.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import logging
import os
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Literal, get_args

from pcretrieve.catalogue import Catalogue, Record

__all__ = ["Batch", "BatchStatus", "batch_status", "written_down"]

logger = logging.getLogger(__name__)

State = Literal["none", "running", "finished", "stopped", "killed"]

PAGE = 4096  # bytes

# Shortest time between two writes; seconds.
INTERVAL = 1.0

# Largest time that can be written as a date, at the end of the year 9999; seconds since 1970.
LATEST = 253_402_300_799

# Number of attempts to lock the file, which a reader may have locked for a moment, and the seconds between.
ATTEMPTS = 3
PAUSE = 0.05


@dataclass(slots=True)
class Batch:
    """The counts of one ingest.

    started, updated: times of the first and of the last count; seconds since 1970.
    stages: total time of each stage of the scans that were processed; seconds.
    """

    state: State = "running"
    started: float = 0.0
    updated: float = 0.0
    workers: int | None = None
    n_scans: int = 0
    n_done: int = 0
    n_failed: int = 0
    n_skipped: int = 0
    stages: dict[str, float] = field(default_factory=dict)

    def add(self, record: Record) -> None:
        """Count a scan that was processed, or that failed."""
        if record.status == "failed":
            self.n_failed += 1
            return
        self.n_done += 1
        for step in record.steps:
            self.stages[step.stage] = self.stages.get(step.stage, 0.0) + step.seconds


@dataclass(frozen=True, slots=True)
class BatchStatus:
    """How far the last ingest into a catalogue is, and what the catalogue has."""

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


@contextmanager
def written_down(location: str, n_scans: int, workers: int | None) -> Iterator[_File]:
    """Write down the counts of an ingest while it works."""
    now = time.time()
    file = _File(_path(location), Batch(started=now, updated=now, workers=workers, n_scans=n_scans))
    try:
        yield file
    except BaseException:
        file.close("stopped")
        raise
    file.close("finished")


def batch_status(catalogue: Catalogue) -> BatchStatus:
    """How far the last ingest into a catalogue is."""
    batch = _read(_path(catalogue.location))
    n_finished = batch.n_done + batch.n_failed
    seconds = (time.time() if batch.state == "running" else batch.updated) - batch.started
    rate = n_finished / seconds if seconds > 0 else 0.0
    left = None
    if batch.state == "running" and rate > 0:
        left = (batch.n_scans - batch.n_skipped - n_finished) / rate
    total = sum(batch.stages.values())
    kinds = Counter({f"{error} in {stage}": n for (stage, error), n in catalogue.failures().items()})
    return BatchStatus(
        state=batch.state,
        started=_iso(batch.started),
        updated=_iso(batch.updated),
        n_scans=batch.n_scans,
        n_done=batch.n_done,
        n_failed=batch.n_failed,
        n_skipped=batch.n_skipped,
        scans_per_second=rate,
        seconds_left=left,
        stages={name: share / total for name, share in batch.stages.items()} if total else {},
        failures=dict(kinds.most_common()),
        n_shapes=len(catalogue),
    )


class _File:
    """The open file of a running ingest; without effect if another ingest has it, or it cannot be written."""

    def __init__(self, path: Path, batch: Batch) -> None:
        self.batch = batch
        self._descriptor: int | None = None
        self._written = 0.0
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        except OSError as error:
            logger.info("the progress of the ingest is not written to %s: %s", path, error.strerror)
            return
        for _ in range(ATTEMPTS):
            with suppress(BlockingIOError):
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                self._descriptor = descriptor
                self._write()
                return
            time.sleep(PAUSE)
        os.close(descriptor)
        logger.info("the progress of the ingest is not written to %s, which another ingest uses", path)

    def write(self) -> None:
        """Write the counts, if the last write was some time ago."""
        if time.monotonic() - self._written >= INTERVAL:
            self._write()

    def close(self, state: State) -> None:
        """Write the counts and the state, and release the file."""
        self.batch.state = state
        self._write()
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def _write(self) -> None:
        self._written = time.monotonic()
        self.batch.updated = time.time()
        if self._descriptor is None:
            return
        data = json.dumps(asdict(self.batch)).encode().ljust(PAGE)
        with suppress(OSError):  # a full disk is the concern of the catalogue
            os.pwrite(self._descriptor, data, 0)
            os.ftruncate(self._descriptor, len(data))


def _read(path: Path) -> Batch:
    """The counts in a file; those of no ingest if there is none."""
    try:
        with path.open("rb") as file:
            batch = _checked(Batch(**json.loads(file.read())))
            with suppress(BlockingIOError):
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
                return replace(batch, state="killed") if batch.state == "running" else batch
            return replace(batch, state="running")
    except (OSError, ValueError, TypeError, AttributeError, RecursionError):
        return Batch(state="none")


def _checked(batch: Batch) -> Batch:
    """The counts of a file; ValueError, TypeError or AttributeError if other values than counts are there."""
    counts = (batch.n_scans, batch.n_done, batch.n_failed, batch.n_skipped)
    numbers = (batch.started, batch.updated, *counts, *batch.stages.values())
    if batch.state not in get_args(State) or not all(0 <= number <= LATEST for number in numbers):
        raise ValueError(f"the counts of an ingest must be numbers from 0, got {batch}")
    return batch


def _path(location: str) -> Path:
    if "://" not in location:
        return Path(location).with_name(f".{Path(location).name}.batch")
    try:
        cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    except RuntimeError:  # there is no user
        cache = Path(os.devnull)
    return cache / "pcretrieve" / f"{hashlib.sha256(location.encode()).hexdigest()[:16]}.batch"


def _iso(seconds: float) -> str | None:
    if not seconds:
        return None
    return datetime.fromtimestamp(seconds, timezone.utc).isoformat(timespec="seconds")
