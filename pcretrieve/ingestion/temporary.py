"""Folders for the temporary files of worker processes, which are removed also after a worker was killed.

The parent process holds a lock on the folder of each of its workers. The system releases the lock when the
parent ends, however that happens: a folder that is not locked belongs to nobody.
"""

from __future__ import annotations

import fcntl
import logging
import os
import shutil
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path

__all__ = ["TemporaryFolder", "remove_abandoned", "use_folder"]

logger = logging.getLogger(__name__)

PREFIX = "pcretrieve-worker-"

# Number of attempts to make a folder: one that is not locked yet may be taken for that of an ended process.
ATTEMPTS = 10


class TemporaryFolder:
    """A folder for the temporary files of one worker, in the parent process.

    The first folder of a process also removes folders that processes of the same user have left behind.
    """

    def __init__(self) -> None:
        remove_abandoned()
        self.path: str | None = None
        self._lock: int | None = None
        for _ in range(ATTEMPTS):
            try:
                path = tempfile.mkdtemp(prefix=PREFIX)
            except OSError as error:
                logger.info("workers have no temporary folder of their own: %s", error)
                return
            self._lock = _locked(Path(path))
            if self._lock is not None:
                self.path = path
                return

    def remove(self) -> None:
        """Remove the folder with all files in it."""
        if self.path is not None and self._lock is not None:
            shutil.rmtree(self.path, ignore_errors=True)
            os.close(self._lock)
            self.path = self._lock = None


def use_folder(path: str | None) -> None:
    """Have Python and native code of this process, and of its children, write temporary files to a folder."""
    if path is not None:
        os.environ["TMPDIR"] = path
        tempfile.tempdir = path


@cache
def remove_abandoned() -> None:
    """Remove the folders of workers whose parent processes have ended."""
    with suppress(OSError):
        for path in Path(tempfile.gettempdir()).glob(f"{PREFIX}*"):
            lock = _locked(path)
            if lock is not None:
                shutil.rmtree(path, ignore_errors=True)
                os.close(lock)


def _locked(path: Path) -> int | None:
    """The descriptor of a folder of this user, which is locked now; None if it is gone, or locked already."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    except OSError:
        return None
    with suppress(OSError):
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.fstat(descriptor).st_uid == os.geteuid() and path.exists():
            return descriptor
    os.close(descriptor)
    return None
