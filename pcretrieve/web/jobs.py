"""Uploaded scans, each processed in an isolated process with limits, a few at a time."""

from __future__ import annotations

import logging
import re
import secrets
from collections import OrderedDict
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Lock
from typing import Literal, TypeAlias

from pcretrieve.errors import PcretrieveError, shape_error
from pcretrieve.ingestion import Isolation
from pcretrieve.ingestion.worker import Worker
from pcretrieve.options import PipelineOptions
from pcretrieve.searching import Described
from pcretrieve.web.requests import Busy, NotFound

__all__ = ["Job", "Jobs", "Upload"]

# Largest number of scans that are received, wait or are processed at a time: more are refused.
MOST_WAITING = 8

# Number of scans whose signature is kept in memory until the server ends.
MOST_KEPT = 200

# The name of the log file of a job, beside the scan, and its lines: of a stage that has ended.
LOG = "stages.log"
STAGE = re.compile(r"^\S+: ([\w-]+) in ([0-9]+\.?[0-9]*) s", re.MULTILINE)

State = Literal["waiting", "running", "done", "failed"]
_Crew: TypeAlias = "list[Worker[Path, Described]]"


@dataclass(slots=True, eq=False)
class Job:
    """One uploaded scan.

    Attributes
    ----------
    id : str
        A random name.
    name : str
        The name of the file, as the browser gave it; no file of the server has it.
    state : {"waiting", "running", "done", "failed"}
        How far it is.
    stages : tuple of (str, float)
        The stages that have ended, and their times in seconds.
    described : Described or None
        The signature and the verdict, if it is done.
    error : PcretrieveError or None
        Why it failed.
    """

    id: str
    name: str
    state: State = "waiting"
    stages: tuple[tuple[str, float], ...] = ()
    described: Described | None = None
    error: PcretrieveError | None = None

    @property
    def has_ended(self) -> bool:
        """Whether the job is done or has failed."""
        return self.state in ("done", "failed")


@dataclass(frozen=True, slots=True, eq=False)
class Upload:
    """A folder for a scan that is received, which is removed when the scan has been processed, or refused.

    Attributes
    ----------
    job : Job
        The job of the scan.
    folder : TemporaryDirectory
        The folder.
    """

    job: Job
    folder: TemporaryDirectory[str] = field(default_factory=lambda: TemporaryDirectory(prefix="pcretrieve-"))


class Jobs:
    """The uploaded scans of a server.

    Parameters
    ----------
    options : PipelineOptions
        The options by which scans are processed.
    timeout : float
        Longest time for a scan; seconds.
    memory : float
        Largest heap of a process; GiB.
    """

    def __init__(self, options: PipelineOptions, *, timeout: float, memory: float) -> None:
        self._function = partial(_described, options)
        self._isolation = Isolation(timeout, memory)
        self._idle: _Crew = []
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="pcretrieve-uploads")
        self._lock = Lock()
        self._jobs: OrderedDict[str, Job] = OrderedDict()
        self._open: dict[str, Upload] = {}

    def begin(self, name: str) -> Upload:
        """Make room for a scan before it is received.

        Parameters
        ----------
        name : str
            The name of its file.

        Returns
        -------
        Upload
            Where the scan is stored; `submit` or `abandon` ends it.

        Raises
        ------
        Busy
            If too many scans wait.
        """
        with self._lock:
            if len(self._open) >= MOST_WAITING:
                raise Busy(f"{MOST_WAITING} scans are waiting already: try again in a minute")
            upload = Upload(Job(secrets.token_urlsafe(12), name))
            self._open[upload.job.id] = upload
        return upload

    def abandon(self, upload: Upload) -> None:
        """Remove a scan that was not received, or has been processed."""
        with self._lock:
            self._open.pop(upload.job.id, None)
        upload.folder.cleanup()

    def submit(self, upload: Upload, scan: Path) -> None:
        """Have a scan processed.

        Parameters
        ----------
        upload : Upload
            From `begin`.
        scan : Path
            The file, in the folder of the upload.
        """
        with self._lock:
            self._jobs[upload.job.id] = upload.job
            if len(self._jobs) > MOST_KEPT:
                self._jobs.popitem(last=False)
        self._thread.submit(self._process, upload, scan)

    def job(self, job_id: str) -> Job:
        """The job of a name, with the stages that have ended until now; NotFound if there is none."""
        with self._lock:
            job, upload = self._jobs.get(job_id), self._open.get(job_id)
        if job is None:
            raise NotFound("there is no such scan: it was uploaded to an earlier server, or is too long ago")
        if upload is not None and job.state == "running":
            job.stages = _stages(Path(upload.folder.name))
        return job

    def close(self) -> None:
        """Refuse the scans that wait, finish the present one, and end the process."""
        self._thread.shutdown(cancel_futures=True)
        for upload in list(self._open.values()):
            self.abandon(upload)
        for worker in self._idle:
            worker.stop()

    def _process(self, upload: Upload, scan: Path) -> None:
        job = upload.job
        job.state = "running"
        outcome: Described | PcretrieveError
        try:
            ((_, outcome),) = self._isolation.each(self._function, [scan], idle=self._idle)
            job.stages = _stages(scan.parent)
        except Exception as error:  # noqa: BLE001  processes cannot be started, or the disk is full
            outcome = shape_error(error)
        self.abandon(upload)
        if isinstance(outcome, PcretrieveError):
            job.error, job.state = outcome, "failed"
        else:
            job.described, job.state = outcome, "done"


def _described(options: PipelineOptions, scan: Path) -> Described:
    """The signature of a scan, in a worker process, which logs its stages beside the scan."""
    from pcretrieve.pipeline.process import judged_signature

    logger, handler = logging.getLogger("pcretrieve.pipeline"), logging.FileHandler(scan.parent / LOG)
    logger.setLevel(logging.INFO)
    logger.addHandler(handler)
    try:
        return Described(*judged_signature(scan, options))
    finally:
        logger.removeHandler(handler)
        handler.close()


def _stages(folder: Path) -> tuple[tuple[str, float], ...]:
    try:
        text = (folder / LOG).read_text("utf-8", "replace")
    except FileNotFoundError:
        return ()
    return tuple((stage, float(seconds)) for stage, seconds in STAGE.findall(text))
