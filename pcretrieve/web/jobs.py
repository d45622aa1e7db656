"""Uploaded scans, each processed in an isolated process with limits, one after the other."""

from __future__ import annotations

import logging
import re
import secrets
import tempfile
from collections import OrderedDict
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from threading import Lock

from pcretrieve.catalogue import Record
from pcretrieve.errors import MemoryExceeded, PcretrieveError, StageTimeout, WorkerDied, shape_error
from pcretrieve.ingestion import Isolation
from pcretrieve.ingestion.temporary import TemporaryFolder
from pcretrieve.ingestion.worker import Worker
from pcretrieve.options import PipelineOptions
from pcretrieve.query import Described
from pcretrieve.web.inspections import inspection_page
from pcretrieve.web.job import Job, Upload
from pcretrieve.web.keeping import Collection
from pcretrieve.web.requests import Busy, NotFound

__all__ = ["Jobs"]

logger = logging.getLogger(__name__)

# Largest number of scans that are received, wait or are processed at a time: more are refused.
MOST_WAITING = 8

# Number of scans whose signature and picture are in memory until the server ends, and of the latest of them
# whose inspection page, of 2 MB, and whose file, if it can be kept, are there too.
MOST_KNOWN = 200
MOST_WHOLE = 20

# The name of the log file of a job, beside the scan, and its lines: of a stage that has ended.
LOG = "stages.log"
STAGE = re.compile(r"^\S+: ([\w-]+) in ([0-9]+\.?[0-9]*) s", re.MULTILINE)


class Jobs:
    """The uploaded scans of a server.

    Their files are removed when they have been inspected, and, if they can be kept, when they were, or are
    too long ago; those of a server that was killed, when the next one starts.

    timeout: longest time for a scan; seconds.
    """

    def __init__(
        self,
        location: str,
        title: str,
        options: PipelineOptions,
        *,
        timeout: float,
        memory: float,
        up: str | None = None,
        collection: Collection | None = None,
    ) -> None:
        self.collection = collection
        self._described = partial(_described, options, up)
        self._inspected = partial(inspection_page, location, title, options)
        self._isolation = Isolation(timeout, memory)
        self._idle: list[Worker[Path, Described]] = []
        self._idle_inspecting: list[Worker[tuple[str, str, Path], bytes]] = []
        # Two threads, so that no answer waits for an inspection.
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="pcretrieve-uploads")
        self._inspecting = ThreadPoolExecutor(1, thread_name_prefix="pcretrieve-inspections")
        self._uninspected: set[str] = set()
        self._lock = Lock()
        self._folder = TemporaryFolder()
        self._jobs: OrderedDict[str, Upload] = OrderedDict()
        self._open: dict[str, Upload] = {}

    def begin(self, name: str) -> Upload:
        """Make room for a scan before it is received."""
        with self._lock:
            if len(self._open) >= MOST_WAITING:
                raise Busy(f"{MOST_WAITING} scans are waiting already: try again in a minute")
            folder = Path(tempfile.mkdtemp(prefix="upload-", dir=self._folder.path))
            upload = Upload(Job(secrets.token_urlsafe(12), name), folder)
            self._open[upload.job.id] = upload
        return upload

    def abandon(self, upload: Upload) -> None:
        """Remove a scan that was not received."""
        with self._lock:
            self._open.pop(upload.job.id, None)
        upload.remove()

    def submit(self, upload: Upload, scan: Path) -> None:
        """Have a scan processed."""
        upload.job.scan = scan
        with self._lock:
            self._jobs[upload.job.id] = upload
            if len(self._jobs) > MOST_KNOWN:
                self._jobs.popitem(last=False)
        self._thread.submit(self._process, upload, scan)

    def job(self, job_id: str) -> Job:
        """The job of a name, with the stages that have ended until now; NotFound if there is none."""
        upload = self._upload(job_id)
        if upload.job.state == "running":
            upload.job.stages = _stages(upload.folder)
        return upload.job

    def keep(self, job_id: str, shape_id: str, label: str | None) -> Future[Record]:
        """Have a scan stored in the collection, after those that wait."""
        return self._thread.submit(self._keep, self._upload(job_id), shape_id, label)

    def close(self) -> None:
        """Refuse the scans that wait, finish the present one, end the process, and remove all files."""
        for thread in (self._thread, self._inspecting):
            thread.shutdown(cancel_futures=True)
        for crew in (self._idle, self._idle_inspecting):
            for worker in crew:
                worker.stop()
        self._folder.remove()

    def _upload(self, job_id: str) -> Upload:
        with self._lock:
            upload = self._jobs.get(job_id)
        if upload is None:
            raise NotFound("there is no such scan: it was uploaded to an earlier server, or is too long ago")
        return upload

    def _process(self, upload: Upload, scan: Path) -> None:
        job = upload.job
        job.state = "running"
        outcome: Described | PcretrieveError
        try:
            ((_, outcome),) = self._isolation.each(self._described, [scan], idle=self._idle)
            job.stages = _stages(upload.folder)
        except Exception as error:  # noqa: BLE001  processes cannot be started, or the disk is full
            outcome = shape_error(error)
        if isinstance(outcome, PcretrieveError):
            job.error, job.state = outcome, "failed"
        else:
            job.described, job.state = outcome, "done"
        with self._lock:
            self._open.pop(job.id, None)
            # What has exceeded the limits once would do so again.
            can_be_inspected = (
                not isinstance(outcome, (StageTimeout, MemoryExceeded, WorkerDied))
                and len(self._uninspected) < MOST_WAITING
            )
            if can_be_inspected:
                self._uninspected.add(job.id)
        if can_be_inspected:
            self._inspecting.submit(self._inspect, upload, scan)
        else:
            self._end(upload, None)

    def _inspect(self, upload: Upload, scan: Path) -> None:
        job = upload.job
        page = None
        try:
            items = [(job.name, f"/scan/{job.id}", scan)]
            ((_, outcome),) = self._isolation.each(self._inspected, items, idle=self._idle_inspecting)
            page = outcome if isinstance(outcome, bytes) else None
        except Exception as error:  # noqa: BLE001  as above
            outcome = shape_error(error)
        if page is None:
            logger.warning("a scan was not inspected: %s", outcome)
        self._end(upload, page)

    def _end(self, upload: Upload, page: bytes | None) -> None:
        """Note the inspection page, None if there is none, and remove what is not needed any more."""
        job = upload.job
        job.page, job.inspection = page, "failed" if page is None else "done"
        if self.collection is None or job.described is None:
            upload.remove()
        with self._lock:
            self._uninspected.discard(job.id)
            for earlier in list(self._jobs.values())[:-MOST_WHOLE]:
                if earlier.job.inspection != "waiting":
                    earlier.job.page = None
                    earlier.remove()

    def _keep(self, upload: Upload, shape_id: str, label: str | None) -> Record:
        job = upload.job
        if self.collection is None:
            raise NotFound("this server keeps no scans: start it with --keep FOLDER")
        if job.kept_as is not None:
            raise NotFound(f"the scan is kept already, as {job.kept_as!r}")
        if job.scan is None:
            raise NotFound("the scan is gone, because it failed or is too long ago: upload it again")
        record = self.collection.add(job.scan, shape_id, label)
        job.kept_as = record.id
        upload.remove()
        return record


def _described(options: PipelineOptions, up: str | None, scan: Path) -> Described:
    """The signature and the picture of a scan, in a worker process, which logs its stages beside the scan."""
    from pcretrieve.query import pictured

    stages, handler = logging.getLogger("pcretrieve.pipeline"), logging.FileHandler(scan.parent / LOG)
    stages.setLevel(logging.INFO)
    stages.addHandler(handler)
    try:
        return pictured(scan, options, up)
    finally:
        stages.removeHandler(handler)
        handler.close()


def _stages(folder: Path) -> tuple[tuple[str, float], ...]:
    try:
        text = (folder / LOG).read_text("utf-8", "replace")
    except FileNotFoundError:
        return ()
    return tuple((stage, float(seconds)) for stage, seconds in STAGE.findall(text))
