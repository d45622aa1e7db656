"""Checks that are made before a file, or a member of an archive, is read."""

from __future__ import annotations

import stat
import zipfile
from pathlib import Path

from pcretrieve.errors import ScanReadError

__all__ = ["DEFLATE_RATIO", "check_archive", "check_file", "member_bytes"]

# Largest compression ratio of deflate, the usual method of archives.
DEFLATE_RATIO = 1032

# Largest compression ratio of an archive of markup as a whole, and number of bytes to which any may expand.
# The ratio of meshes in XML is small, 7.3 of a grid of a million vertices with integer coordinates: an
# archive that expands to much more was made to fill the memory.
MARKUP_RATIO = 100
ANY_MARKUP = 10_000_000


def check_file(path: Path) -> None:
    """Check that a path is a regular file with content.

    Opening a pipe would wait for a writer, and reading a device may not end.
    """
    status = path.stat()
    if stat.S_ISDIR(status.st_mode):
        raise ScanReadError(f"{path} is a folder, not a scan")
    if not stat.S_ISREG(status.st_mode):
        raise ScanReadError(f"{path} must be a regular file, not a pipe or a device: save the scan to a file")
    if not status.st_size:
        raise ScanReadError("the file is empty: scan or export it again")


def member_bytes(archive: zipfile.ZipFile, name: str | zipfile.ZipInfo) -> bytes:
    """The content of a member of an archive, whose size is checked before the member is read."""
    info = archive.getinfo(name) if isinstance(name, str) else name
    _check_ratio(info)
    return archive.read(info)


def check_archive(archive: zipfile.ZipFile) -> None:
    """Check, before a library reads it, that an archive of markup does not expand to too much."""
    members = archive.infolist()
    size, packed = sum(info.file_size for info in members), sum(info.compress_size for info in members)
    if size > max(ANY_MARKUP, MARKUP_RATIO * packed):
        raise ScanReadError(f"its members declare {size} bytes in {packed}")


def _check_ratio(info: zipfile.ZipInfo) -> None:
    if info.file_size > DEFLATE_RATIO * (info.compress_size + 1):
        raise ScanReadError(
            f"its member {info.filename} declares {info.file_size} bytes in {info.compress_size}"
        )
