"""Files → stamps, by which a file that has not changed since it was hashed is known without reading it."""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

from pcretrieve.errors import ScanReadError
from pcretrieve.formats import check_file, parts_of, url_of

__all__ = ["SETTLED", "Stamp", "stamp_of"]

#: Least time between the last change of a file and its hashing for its stamp to be stored; seconds. A
#: file that is changed again directly after it was hashed may have the same times, which some file
#: systems round to two seconds (git calls such files racy), and the clock of a file server may differ
#: from that of this computer.
SETTLED = 60.0


class Stamp(NamedTuple):
    """What a file system says of a file and of the parts that the file names.

    text: size in bytes, times of the last changes of the content (mtime) and of the inode (ctime) in
        nanoseconds, and number of the inode, of each file.
    changed: the latest of these times; seconds since 1970.
    """

    text: str
    changed: float


def stamp_of(file: Path) -> Stamp | None:
    """The stamp of a file. Two equal stamps of a path, of which the first was settled, are of one content.

    Every writing to a file, and every change of its attributes, sets its ctime, which no user can set to
    another time. A file whose mtime was put back after a change therefore has another stamp. Not noticed
    are: a change while the clock of the computer was put back, with the ctime of before to the
    nanosecond; a change of the disk under its file system, such as a flipped bit; and, on file systems
    without a ctime (FAT, some over a network or by FUSE), a change after which size and mtime were put
    back. The device is left out, because its number may change when the computer starts, and differs
    between the computers of a cluster.
    """
    if url_of(file) is not None:
        return None
    try:
        check_file(file)
        found = [_status_of(part) for part in (file, *(part.path for part in parts_of(file)))]
    except (ScanReadError, OSError, ValueError):
        return None
    text = "; ".join(f"{one.st_size} {one.st_mtime_ns} {one.st_ctime_ns} {one.st_ino}" for one in found)
    return Stamp(text, max(max(one.st_mtime, one.st_ctime) for one in found))


def _status_of(file: Path) -> os.stat_result:
    check_file(file)
    # Of the opened file, because a network file system may say what it knew of a file that is not opened.
    with file.open("rb") as opened:
        return os.fstat(opened.fileno())
