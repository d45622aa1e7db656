"""One uploaded scan: how far it is, and what is known of it."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pcretrieve.errors import PcretrieveError
from pcretrieve.searching import Described

__all__ = ["Job", "Upload"]

State = Literal["waiting", "running", "done", "failed"]


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
        How far its signature is.
    stages : tuple of (str, float)
        The stages that have ended, and their times in seconds.
    described : Described or None
        The signature, the verdict and the picture, if it is done.
    error : PcretrieveError or None
        Why it failed.
    inspection : {"waiting", "done", "failed"}
        How far its inspection page is, which is made after the signature, also of a scan that failed.
    page : bytes or None
        The inspection page, if it is done, and not too long ago.
    scan : Path or None
        The file, if it is still there.
    kept_as : str or None
        The id of the shape, if the scan was kept.
    """

    id: str
    name: str
    state: State = "waiting"
    stages: tuple[tuple[str, float], ...] = ()
    described: Described | None = None
    error: PcretrieveError | None = None
    inspection: Literal["waiting", "done", "failed"] = "waiting"
    page: bytes | None = None
    scan: Path | None = None
    kept_as: str | None = None

    @property
    def has_ended(self) -> bool:
        """Whether the job is done or has failed."""
        return self.state in ("done", "failed")


@dataclass(frozen=True, slots=True, eq=False)
class Upload:
    """A scan that is received or processed.

    Attributes
    ----------
    job : Job
        The job of the scan.
    folder : Path
        A folder for its files alone.
    """

    job: Job
    folder: Path

    def remove(self) -> None:
        """Remove the folder."""
        self.job.scan = None
        shutil.rmtree(self.folder, ignore_errors=True)
