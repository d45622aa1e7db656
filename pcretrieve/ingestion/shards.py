"""Shards: the parts into which the tasks of a job array divide scans, without knowing of each other."""

from __future__ import annotations

import hashlib
import os
import re
import stat
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pcretrieve.errors import OptionError
from pcretrieve.formats import split_member

__all__ = ["Shard", "scans_of"]

# Number of bytes at the beginning and at the end of a file that choose its shard. All tasks read these bytes
# of all files, but only one task reads the rest of a file.
END = 4096


@dataclass(frozen=True, slots=True)
class Shard:
    """One of several parts of any scans.

    The shard of a scan depends on its content only: new files change the shard of no other file, and copies
    of a file are in its shard, which skips them as duplicates.
    """

    number: int
    of: int

    def __post_init__(self) -> None:
        if not 1 <= self.number <= self.of:
            raise OptionError(f"a shard must be I/N with I from 1 to N, got {self.number}/{self.of}")

    @classmethod
    def parse(cls, text: str) -> Shard:
        """Read a shard that is written as ``I/N``."""
        match = re.fullmatch(r"([0-9]{1,9})/([0-9]{1,9})", text)
        if match is None:
            raise OptionError(f"a shard must be I/N, such as 3/10, got {text!r}")
        return cls(int(match[1]), int(match[2]))

    def holds(self, scan: Path) -> bool:
        """Whether a scan is in this shard."""
        return int.from_bytes(_key(scan), "big") % self.of == self.number - 1


def scans_of(shard: str | None, scans: Sequence[Path]) -> Sequence[Path]:
    """The scans that a task of a job array processes."""
    if shard is None:
        return scans
    part = Shard.parse(shard)
    return [scan for scan in scans if part.holds(scan)]


def _key(scan: Path) -> bytes:
    """A hash of the size and the ends of a file; of the path, if the file cannot be read."""
    file, name = split_member(scan)
    digest = hashlib.sha256(os.fsencode(name or ""))
    try:
        status = file.stat()
        if not stat.S_ISREG(status.st_mode):  # reading a pipe would wait
            raise OSError
        with file.open("rb") as opened:
            digest.update(b"%d" % status.st_size + opened.read(END))
            opened.seek(max(status.st_size - END, 0))
            digest.update(opened.read(END))
    except (OSError, ValueError):
        digest = hashlib.sha256(os.fsencode(scan))
    return digest.digest()
