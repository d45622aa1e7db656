"""Which files may be opened at all."""

from __future__ import annotations

import stat
from pathlib import Path

from pcretrieve.errors import ScanReadError

__all__ = ["check_file"]


def check_file(path: Path) -> None:
    """Check, before a file is opened, that reading it comes to an end and gives something.

    Opening a pipe waits for a writer, and reading a device may go on until the memory is full.

    Parameters
    ----------
    path : Path
        Symbolic links are followed.

    Raises
    ------
    OSError
        If there is no such file.
    ScanReadError
        If it is not a regular file, or empty.
    """
    status = path.stat()
    if stat.S_ISDIR(status.st_mode):
        raise ScanReadError(f"{path} is a folder, not a scan")
    if not stat.S_ISREG(status.st_mode):
        raise ScanReadError(f"{path} must be a regular file, not a pipe or a device: save the scan to a file")
    if not status.st_size:
        raise ScanReadError("the file is empty: scan or export it again")
