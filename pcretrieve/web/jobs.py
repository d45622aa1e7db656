"""Uploaded scans, each processed in an isolated process with limits, one after the other."""

from __future__ import annotations

import logging
import secrets
import shutil
import tempfile
from collections import OrderedDict
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Lock
from typing import Any, Literal
from urllib.parse import quote

from pcretrieve import PipelineOptions, Record
from pcretrieve.errors import (
    MemoryExceeded,
    PcretrieveError,
    StageTimeout,
    WorkerDied,
    shape_error,
)
from pcretrieve.gallery.answers import Described
from pcretrieve.ingestion.pool import TemporaryFolder, in_processes
from pcretrieve.pages.thumbnails import Thumbnails
from pcretrieve.web.keeping import Collection, described, inspection_page
from pcretrieve.web.requests import Refused

logger = logging.getLogger(__name__)

# Largest number of scans that are received, wait or are processed at a time: more are refused.
MOST_WAITING = 8

# Number of scans whose signature and picture are in memory until the server ends, and of the latest of them
# whose inspection page, of 2 MB, and whose file, if it can be kept, are there too.
MOST_KNOWN = 200
MOST_WHOLE = 20


@dataclass(slots=True, eq=False)
class Job:
    """One uploaded scan in a folder of its own: how far it is, and what is known of it.

    stages: tuple of (str, float), the stages that have ended, and their times in seconds.
    """

    id: str
    name: str
    folder: Path
    state: Literal["waiting", "running", "done", "failed"] = "waiting"
    stages: tuple[tuple[str, float], ...] = ()
    described: Described | None = None
    error: PcretrieveError | None = None
    inspection: Literal["waiting", "done", "failed"] = "waiting"
    page: bytes | None = None
    scan: Path | None = None
    kept_as: str | None = None

    @property
    def has_ended(self) -> bool:
        """Whether the scan is processed and inspected, as far as that can be done."""
        return self.state in ("done", "failed") and self.inspection != "waiting"

    def hear(self, stage: tuple[str, float]) -> None:
        """Note a stage that has ended."""
        self.stages = (*self.stages, stage)

    def remove(self) -> None:
        """Remove the folder."""
        self.scan = None
        shutil.rmtree(self.folder, ignore_errors=True)


class Jobs:
    """The uploaded scans of a server.

    Their files are removed when they have been inspected, and, if they can be kept, when they were, or are
    too long ago; those of a server that was killed, when the next one starts.
    """

    def __init__(
        self,
        location: str,
        title: str,
        options: PipelineOptions,
        *,
        timeout: float,
        memory: float | None,
        thumbnails: Thumbnails,
        collection: Collection | None = None,
    ) -> None:
        self.collection = collection
        self._described, self._thumbnails = partial(described, options), thumbnails
        self._inspected = partial(inspection_page, title, options)
        self._limits: dict[str, Any] = {
            "workers": 1,
            "timeout": timeout,
            "memory": memory,
        }
        self._idle: list[Any] = []
        self._idle_inspecting: list[Any] = []
        # Two threads, so that no answer waits for an inspection.
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="pcretrieve-uploads")
        self._inspecting = ThreadPoolExecutor(
            1, thread_name_prefix="pcretrieve-inspections"
        )
        self._uninspected: set[str] = set()
        self._lock = Lock()
        self._folder = TemporaryFolder()
        self._jobs: OrderedDict[str, Job] = OrderedDict()
        self._open: set[str] = set()

    def begin(self, name: str) -> Job:
        """Make room for a scan before it is received."""
        with self._lock:
            if len(self._open) >= MOST_WAITING:
                raise Refused(
                    f"{MOST_WAITING} scans are waiting already: try again in a minute",
                    503,
                )
            folder = Path(tempfile.mkdtemp(prefix="upload-", dir=self._folder.path))
            job = Job(secrets.token_urlsafe(12), name, folder)
            self._open.add(job.id)
            self._jobs[job.id] = job
            if len(self._jobs) > MOST_KNOWN:
                self._jobs.popitem(last=False)
        return job

    def inspect(self, name: str, scan: Path) -> Job:
        """Have the file of a stored shape inspected, and nothing else."""
        if not scan.is_file():
            raise Refused(f"the file of {name!r} is not there any more")
        job = self.begin(name)
        job.state = "done"
        with self._lock:
            # It stays open until it is inspected, and is counted among those that wait.
            self._uninspected.add(job.id)
        self._inspecting.submit(
            self._inspect, job, scan, f"/shape/{quote(name, safe='')}"
        )
        return job

    def abandon(self, job: Job) -> None:
        """Remove a scan that was not received."""
        with self._lock:
            self._open.discard(job.id)
            self._jobs.pop(job.id, None)
        job.remove()

    def submit(self, job: Job, scan: Path) -> None:
        """Have a scan processed."""
        job.scan = scan
        self._thread.submit(self._process, job, scan)

    def job(self, job_id: str) -> Job:
        """The job of a name, with the stages that have ended until now; Refused if there is none."""
        with self._lock:
            job = self._jobs.get(job_id)
        if job is None:
            raise Refused(
                "there is no such scan: it was uploaded to an earlier server, or is too long ago"
            )
        return job

    def keep(self, job_id: str, shape_id: str, label: str | None) -> Future[Record]:
        """Have a scan stored in the collection, after those that wait."""
        return self._thread.submit(self._keep, self.job(job_id), shape_id, label)

    def close(self) -> None:
        """Refuse the scans that wait, finish the present one, end the process, and remove all files."""
        for thread in (self._thread, self._inspecting):
            thread.shutdown(cancel_futures=True)
        for worker in (*self._idle, *self._idle_inspecting):
            worker.stop()
        self._folder.remove()

    def _process(self, job: Job, scan: Path) -> None:
        job.state = "running"
        outcome: Described | PcretrieveError
        try:
            items = [(scan, self._thumbnails.up)]
            running = in_processes(
                self._described, items, idle=self._idle, told=job.hear, **self._limits
            )
            ((_, outcome),) = running
        except Exception as error:  # noqa: BLE001  processes cannot be started, or the disk is full
            outcome = shape_error(error)
        if isinstance(outcome, PcretrieveError):
            job.error, job.state = outcome, "failed"
        else:
            job.described, job.state = outcome, "done"
        with self._lock:
            self._open.discard(job.id)
            # What has exceeded the limits once would do so again.
            can_be_inspected = (
                not isinstance(outcome, (StageTimeout, MemoryExceeded, WorkerDied))
                and len(self._uninspected) < MOST_WAITING
            )
            if can_be_inspected:
                self._uninspected.add(job.id)
        if can_be_inspected:
            self._inspecting.submit(self._inspect, job, scan, f"/scan/{job.id}")
        else:
            self._end(job, None)

    def _inspect(self, job: Job, scan: Path, back: str) -> None:
        page = None
        try:
            items = [(job.name, back, scan)]
            running = in_processes(
                self._inspected, items, idle=self._idle_inspecting, **self._limits
            )
            ((_, outcome),) = running
            page = outcome if isinstance(outcome, bytes) else None
        except Exception as error:  # noqa: BLE001  as above
            outcome = shape_error(error)
        if page is None:
            logger.warning("a scan was not inspected: %s", outcome)
        self._end(job, page)

    def _end(self, job: Job, page: bytes | None) -> None:
        """Note the inspection page, None if there is none, and remove what is not needed any more."""
        job.page, job.inspection = page, "failed" if page is None else "done"
        if self.collection is None or job.described is None:
            job.remove()
        with self._lock:
            self._uninspected.discard(job.id)
            self._open.discard(job.id)
            for earlier in list(self._jobs.values())[:-MOST_WHOLE]:
                if earlier.inspection != "waiting":
                    earlier.page = None
                    earlier.remove()

    def _keep(self, job: Job, shape_id: str, label: str | None) -> Record:
        if self.collection is None:
            raise Refused("this server keeps no scans: start it with --keep FOLDER")
        if job.kept_as is not None:
            raise Refused(f"the scan is kept already, as {job.kept_as!r}")
        if job.scan is None:
            raise Refused(
                "the scan is gone, because it failed or is too long ago: upload it again"
            )
        record = self.collection.add(job.scan, shape_id, label)
        job.kept_as = record.id
        job.remove()
        return record
