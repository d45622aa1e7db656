"""Atomic writing: at any time a file is complete, as it was before or as it is afterwards."""

from __future__ import annotations

import os
import secrets
import stat
from pathlib import Path

from pcretrieve.errors import InputError

__all__ = ["write_file"]


def write_file(path: Path, data: bytes) -> None:
    """Write a file in one step: at any time, its path has the old content or all of the new content.

    The data are written to a temporary file in the same directory, which is renamed when the data have
    reached the disk. The file gets the permissions of a new file. A symbolic link is followed. A path that is
    not a regular file, such as ``/dev/stdout``, cannot be replaced, and is written directly.
    """
    try:
        if path.exists() and not stat.S_ISREG(path.stat().st_mode):
            path.write_bytes(data)
        else:
            _replace(Path(os.path.realpath(path)), data)
    except OSError as error:
        raise InputError(
            f"cannot write {path}: {error.strerror or error}; name a file in a folder that exists and can be "
            "written"
        ) from error


def _replace(target: Path, data: bytes) -> None:
    # A short name, because a name longer than that of the file might be too long.
    temporary = target.with_name(f".{secrets.token_hex(8)}.part")
    descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)  # without the umask
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(target)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
