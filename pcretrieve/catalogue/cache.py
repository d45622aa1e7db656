"""Arrays that are computed from one state of a catalogue, in files that are mapped into memory.

They are in the cache folder of the user, which may be deleted. Nothing is stored beside the file of a
catalogue, because that folder may come from somebody else, with links to folders of the reader in it.
"""

from __future__ import annotations

import hashlib
import json
import logging
import math
import os
import re
import shutil
import time
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from tempfile import mkdtemp
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

logger = logging.getLogger(__name__)

Made = TypeVar("Made")

# Smallest number of bytes of an array that is mapped into memory; smaller arrays are read.
MAPPED = 2**16

# The file with the checksum of each file of arrays.
CHECKSUMS = "checksums.json"

# Largest array that is compared with its checksum whenever it is opened: 16 MiB are read in 10 ms.
CHECKED = 2**24

# Beginning of the name of an unfinished folder; after so many seconds its process must have been killed.
UNFINISHED = ".unfinished-"
ABANDONED = 3600.0

# Names of the folders of indexes and of maps, which end in the state of the catalogue. Only folders with such
# a name and a file of checksums are removed.
KEPT_NAME = re.compile(r"[0-9a-f]{16}-[0-9a-f]{16}|map-\d+-\d+-[0-9a-f]{16}")


class ArrayCache:
    """The stored arrays of one catalogue, which several processes may use at the same time.

    location: the absolute path of the catalogue or the URL of its database, without a password.

    Attributes: `last`, what was made last of stored arrays, in memory, and the name of these arrays.
    """

    def __init__(self, location: str) -> None:
        self.folder: Path | None = None
        with suppress(RuntimeError):  # there is no user
            cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
            self.folder = (
                cache / "pcretrieve" / f"{Path(location).name}-{short_digest(location)}"
            )
        self.last: tuple[str, Any] | None = None

    def opened(
        self, name: str, read: Callable[[dict[str, NDArray[Any]]], Made]
    ) -> Made | None:
        """What `read` makes of stored arrays; None if there are none."""
        if self.folder is None:
            return None
        kept = self.folder / name
        try:
            return read(_arrays(kept))
        except FileNotFoundError:
            return None  # there is none, or another process removes it at this moment
        # NumPy reads the header of an array by parsers of Python, and lets their exceptions pass.
        except Exception as error:  # noqa: BLE001
            logger.warning(
                "computed again, because it cannot be read: %s (%s)", kept, error
            )
            remove_kept(kept)
            return None

    def keep(self, name: str, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Store arrays, and remove those of other states and what killed processes left."""
        if self.folder is None:
            return
        try:
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            _write(self.folder, name, arrays)
            for kept in self._kept():
                if kept.name.rpartition("-")[2] != name.rpartition("-")[2]:
                    remove_kept(kept)
            self._remove_abandoned()
        except OSError as error:
            logger.info("an index is not stored in %s: %s", self.folder, error)

    def faults(self) -> Iterator[tuple[Path, str]]:
        """Yield the stored indexes whose bytes have changed since they were written, and how."""
        for kept in self._kept():
            try:
                _arrays(kept, checked=math.inf)
            except FileNotFoundError:
                continue  # another process removes it at this moment
            except Exception as error:  # noqa: BLE001  as in `opened`
                yield kept, f"cannot be read: {error}"

    def clear(self) -> None:
        """Remove all that is stored of this catalogue, which has ids and classes of shapes."""
        self.last = None
        for kept in self._kept():
            remove_kept(kept)
        self._remove_abandoned()

    def _kept(self) -> list[Path]:
        """The folders that a cache of this catalogue has written; never what a link leads to."""
        if self.folder is None or not self.folder.is_dir():
            return []
        return [folder for folder in sorted(self.folder.iterdir()) if is_kept(folder)]

    def _remove_abandoned(self) -> None:
        """Remove what killed processes left."""
        if self.folder is None:
            return
        for unfinished in self.folder.glob(f"{UNFINISHED}*"):
            with suppress(OSError):
                if unfinished.lstat().st_mtime < time.time() - ABANDONED:
                    # It removes nothing through a link.
                    shutil.rmtree(unfinished, ignore_errors=True)


def is_kept(folder: Path) -> bool:
    """Whether a path is a folder that a cache has written: by its name, its checksums, and as no link."""
    named = KEPT_NAME.fullmatch(folder.name) is not None
    return named and not folder.is_symlink() and (folder / CHECKSUMS).is_file()


def remove_kept(folder: Path) -> None:
    """Remove a folder that a cache has written, and nothing else."""
    if is_kept(folder):
        shutil.rmtree(folder, ignore_errors=True)


def short_digest(text: str) -> str:
    """Sixteen hexadecimal digits of a hash."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _arrays(folder: Path, checked: float = CHECKED) -> dict[str, NDArray[Any]]:
    """The arrays of an index; those of at most `checked` bytes are compared with their checksums."""
    sums = json.loads((folder / CHECKSUMS).read_text("utf-8"))
    arrays = {}
    for name in sorted(sums):
        file = folder / name
        if not file.is_file():
            raise ValueError(f"{name} is missing")
        size = file.stat().st_size
        if size <= checked and zlib.crc32(file.read_bytes()) != sums[name]:
            raise ValueError(f"{name} was changed")
        arrays[file.stem] = np.load(
            file, mmap_mode="r" if size >= MAPPED else None, allow_pickle=False
        )
    return arrays


def _write(folder: Path, name: str, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write all arrays or none: the folder gets its name after all arrays are on the disk."""
    unfinished = Path(mkdtemp(prefix=UNFINISHED, dir=folder))
    try:
        for array_name, array in arrays.items():
            with (unfinished / f"{array_name}.npy").open("xb") as file:
                np.save(file, array, allow_pickle=False)
                file.flush()
                os.fsync(file.fileno())
        sums = {file.name: zlib.crc32(file.read_bytes()) for file in unfinished.iterdir()}
        (unfinished / CHECKSUMS).write_text(json.dumps(sums), "utf-8")
        unfinished.rename(folder / name)
    except OSError:
        if not (folder / name).is_dir():  # another process was faster
            raise
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
