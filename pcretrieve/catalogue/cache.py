"""Cache of the indexes of a catalogue, as arrays that are mapped into memory.

An index of a million shapes takes seconds to compute and milliseconds to open. It is stored in a folder
beside the file of the catalogue, ``bodies.sqlite.gallery``, or in the cache folder of the user if that folder
cannot be written. An index belongs to one state of the catalogue, and is computed again after a change. The
folder may be deleted.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import shutil
import time
import zlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcretrieve.catalogue.rows import Revision
from pcretrieve.retrieval import SignatureIndex

logger = logging.getLogger(__name__)

# Version of the arrays of an index, which is incremented when their meaning changes.
FORMAT = 8

# Smallest number of shapes for which an index is stored.
SMALLEST_KEPT = 1_000

# Smallest number of bytes of an array that is mapped into memory; smaller arrays are read.
MAPPED = 2**16

# The file with the checksum of each file of arrays.
CHECKSUMS = "checksums.json"

# Largest number of bytes of an array that is compared with its checksum whenever it is opened: 16 MiB are
# read in about 10 ms.
CHECKED = 2**24

# Beginning of the name of a folder until it is complete, and the age in seconds after which such a folder is
# removed, because the process that wrote it must have been killed.
UNFINISHED = ".unfinished-"
ABANDONED = 3600.0


class IndexCache:
    """The stored indexes of one catalogue, which several processes may use at the same time.

    folder: the first folder to store them in; None for that of the user's cache alone.
    """

    def __init__(self, location: str, folder: Path | None) -> None:
        self._folders = [folder] if folder else []
        try:
            cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        except RuntimeError:  # there is no user
            pass
        else:
            # The absolute path distinguishes files of one name in several folders.
            name = str(folder.absolute()) if folder else location
            self._folders.append(cache / "pcretrieve" / f"{Path(location).name}-{_digest(name)}")
        self._last: tuple[str, SignatureIndex] | None = None

    def index(
        self,
        request: str,
        revision: Revision,
        make: Callable[[], tuple[SignatureIndex, Revision]],
    ) -> SignatureIndex:
        """Open the stored index of a state of the catalogue, or compute and store it."""
        request = f"{FORMAT} {request}"
        name = _name(request, revision)
        if self._last is None or self._last[0] != name:
            index = self._opened(name)
            if index is None:
                index, revision = make()
                name = _name(request, revision)
                if len(index) >= SMALLEST_KEPT:
                    self._keep(name, revision, index)
                    # The stored index replaces the one in memory, which is then freed.
                    index = self._opened(name) or index
            self._last = name, index
        return self._last[1]

    def faults(self) -> Iterator[tuple[Path, str]]:
        """Yield the stored indexes whose bytes have changed since they were written, and how."""
        for folder in self._folders:
            for kept in sorted(folder.iterdir()) if folder.is_dir() else ():
                if not kept.name.startswith(UNFINISHED) and (fault := _fault(kept)):
                    yield kept, fault

    def _opened(self, name: str) -> SignatureIndex | None:
        for folder in self._folders:
            kept = folder / name
            try:
                return SignatureIndex.from_arrays(_arrays(kept))
            except FileNotFoundError:
                continue  # there is none, or another process removes it at this moment
            # NumPy reads the header of an array by parsers of Python, and lets their exceptions pass.
            except Exception as error:  # noqa: BLE001
                logger.warning("computed again, because it cannot be read: %s (%s)", kept, error)
                shutil.rmtree(kept, ignore_errors=True)
        return None

    def _keep(self, name: str, revision: Revision, index: SignatureIndex) -> None:
        """Store an index in the first folder that can be written, and remove indexes of other states."""
        for folder in self._folders:
            try:
                folder.mkdir(parents=True, exist_ok=True)
                _write(folder, name, index.to_arrays())
                _tidy(folder, revision)
                return
            except OSError as error:
                logger.info("an index is not stored in %s: %s", folder, error)


def _name(request: str, revision: Revision) -> str:
    return f"{_digest(request)}-{_digest(revision.state())}"


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _arrays(folder: Path) -> dict[str, NDArray[Any]]:
    sums = json.loads((folder / CHECKSUMS).read_text("utf-8"))
    arrays = {}
    for name in sorted(sums):
        file = folder / name
        if not file.is_file():
            raise ValueError(f"{name} is missing")
        size = file.stat().st_size
        if size <= CHECKED and zlib.crc32(file.read_bytes()) != sums[name]:
            raise ValueError(f"{name} was changed")
        arrays[file.stem] = np.load(file, mmap_mode="r" if size >= MAPPED else None, allow_pickle=False)
    return arrays


def _fault(folder: Path) -> str | None:
    """How a stored index has changed; None if it has not, or another process removes it at this moment."""
    try:
        sums = json.loads((folder / CHECKSUMS).read_text("utf-8"))
        changed = [name for name, given in sums.items() if zlib.crc32((folder / name).read_bytes()) != given]
    except FileNotFoundError as error:
        is_there = (folder / CHECKSUMS).exists()
        return f"lacks the file {Path(error.filename).name}" if is_there else None
    except (OSError, ValueError, AttributeError) as error:
        return f"cannot be read: {error}"
    return f"has changed on the disk: {', '.join(changed)}" if changed else None


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
        unfinished.chmod(0o755)
        unfinished.rename(folder / name)
    except OSError:
        if not (folder / name).is_dir():  # another process was faster
            raise
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def _tidy(folder: Path, revision: Revision) -> None:
    """Remove indexes of other states, and incomplete folders of killed processes."""
    current = _digest(revision.state())
    for kept in folder.iterdir():
        if kept.name.startswith(UNFINISHED):
            stale = kept.stat().st_mtime < time.time() - ABANDONED
        else:
            stale = kept.name.rpartition("-")[2] != current
        if stale:
            shutil.rmtree(kept, ignore_errors=True)
