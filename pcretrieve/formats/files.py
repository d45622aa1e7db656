"""A check that is made before a file is opened."""

from __future__ import annotations

import stat
from pathlib import Path

from pcretrieve.errors import ScanReadError

__all__ = ["check_file"]


def check_file(path: Path) -> None:
    """Check that a path is a regular file with content.

    Opening a pipe would wait for a writer, and reading a device may not end.

    Parameters
    ----------
    path : Path
        The path; symbolic links are followed.

    Raises
    ------
    OSError
        If the path does not exist.
    ScanReadError
        If it is not a regular file, or is empty.
    """
    status = path.stat()
    if stat.S_ISDIR(status.st_mode):
        raise ScanReadError(f"{path} is a folder, not a scan")
    if not stat.S_ISREG(status.st_mode):
        raise ScanReadError(f"{path} must be a regular file, not a pipe or a device: save the scan to a file")
    if not status.st_size:
        raise ScanReadError("the file is empty: scan or export it again")
