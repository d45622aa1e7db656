"""One uploaded scan: how far it is, and what is known of it."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pcretrieve.errors import PcretrieveError
from pcretrieve.query import Described

__all__ = ["Job", "Upload"]

State = Literal["waiting", "running", "done", "failed"]


@dataclass(slots=True, eq=False)
class Job:
    """One uploaded scan.

    stages: tuple of (str, float), the stages that have ended, and their times in seconds.
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
    """A scan that is received or processed."""

    job: Job
    folder: Path

    def remove(self) -> None:
        """Remove the folder."""
        self.job.scan = None
        shutil.rmtree(self.folder, ignore_errors=True)
