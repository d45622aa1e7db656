"""Cache of the indexes and maps of a catalogue, as arrays that are mapped into memory.

An index of a million shapes takes 75 s and 2.3 GiB to compute, with the default options, and milliseconds to
open. It is stored in the cache folder of the user, and belongs to one state of the catalogue. The folder may
be deleted.

Nothing is stored beside the file of a catalogue, because that folder may come from somebody else, with links
to folders of the reader in it.
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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcretrieve.options import PipelineOptions, fused_names
from pcretrieve.plugins import METHODS
from pcretrieve.retrieval import SignatureIndex
from pcretrieve.retrieval.clusters import plane_map
from pcretrieve.retrieval.whitening import read_whitening
from pcretrieve.values import FloatArray

logger = logging.getLogger(__name__)

# Version of the arrays of an index, which is incremented when their meaning changes.
FORMAT = 11

# Smallest number of shapes for which an index is stored.
SMALLEST_KEPT = 1_000

# Smallest number of bytes of an array that is mapped into memory; smaller arrays are read.
MAPPED = 2**16

# The file with the checksum of each file of arrays.
CHECKSUMS = "checksums.json"

# Largest array that is compared with its checksum whenever it is opened: 16 MiB are read in 10 ms.
CHECKED = 2**24

# Beginning of the name of an unfinished folder; after so many seconds its process must have been killed.
UNFINISHED = ".unfinished-"
ABANDONED = 3600.0

# Names of the folders of indexes and of maps. Only folders with such a name and a file of checksums are
# removed.
KEPT_NAME = re.compile(r"[0-9a-f]{16}-[0-9a-f]{16}|map-\d+-\d+-[0-9a-f]{16}")


def signatures_digest(options: PipelineOptions) -> str:
    """The digest of the signatures that are compared by some options."""
    # With the version of the package of the descriptor, because other versions may give other values.
    method = options.signature.method
    if METHODS.keys() >= {*fused_names(method)}:
        return options.signature_digest
    from pcretrieve.descriptors import DESCRIPTORS

    return options.signature_digest + DESCRIPTORS.version(method)


class IndexCache:
    """The stored indexes of one catalogue, which several processes may use at the same time.

    location: the absolute path of the catalogue or the URL of its database, without a password.
    """

    def __init__(self, location: str) -> None:
        self.folder: Path | None = None
        with suppress(RuntimeError):  # there is no user
            cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
            self.folder = cache / "pcretrieve" / f"{Path(location).name}-{_digest(location)}"
        self._last: tuple[str, SignatureIndex] | None = None

    def index(
        self,
        options: PipelineOptions,
        revision: str,
        make: Callable[[], tuple[SignatureIndex, str]],
    ) -> SignatureIndex:
        """Open the stored index of a state of the catalogue, or compute and store it."""
        name = _name(options, revision)
        if self._last is None or self._last[0] != name:
            index: SignatureIndex | None = self._opened(name, SignatureIndex.from_arrays)
            if index is None:
                index, revision = make()
                name = _name(options, revision)
                if len(index) >= SMALLEST_KEPT:
                    self._keep(name, index.to_arrays())
                    # The stored index replaces the one in memory, which is then freed.
                    index = self._opened(name, SignatureIndex.from_arrays) or index
            self._last = name, index
        return self._last[1]

    def places(self, points: FloatArray, revision: str) -> FloatArray:
        """The places of points of an index on a map, as by `plane_map`, stored as an index is."""
        name = f"map-{FORMAT}-{zlib.crc32(points.tobytes())}-{_digest(revision)}"
        places: FloatArray | None = self._opened(name, lambda arrays: arrays["places"])
        if places is None:
            places = plane_map(points)
            if len(points) >= SMALLEST_KEPT:
                self._keep(name, {"places": places})
        return places

    def faults(self) -> Iterator[tuple[Path, str]]:
        """Yield the stored indexes whose bytes have changed since they were written, and how."""
        for kept in self._kept():
            try:
                _arrays(kept, checked=math.inf)
            except FileNotFoundError:
                continue  # another process removes it at this moment
            except Exception as error:  # noqa: BLE001  as in `_opened`
                yield kept, f"cannot be read: {error}"

    def clear(self) -> None:
        """Remove all that is stored of this catalogue, which has ids and classes of shapes."""
        self._last = None
        for kept in self._kept():
            remove_kept(kept)
        self._remove_abandoned()

    def _kept(self) -> list[Path]:
        """The folders that a cache of this catalogue has written; never what a link leads to."""
        if self.folder is None or not self.folder.is_dir():
            return []
        return [folder for folder in sorted(self.folder.iterdir()) if is_kept(folder)]

    def _opened(self, name: str, read: Callable[[dict[str, NDArray[Any]]], Any]) -> Any:
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
            logger.warning("computed again, because it cannot be read: %s (%s)", kept, error)
            remove_kept(kept)
            return None

    def _keep(self, name: str, arrays: Mapping[str, NDArray[Any]]) -> None:
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


def _name(options: PipelineOptions, revision: str) -> str:
    """A name of everything that an index depends on; that of the shapes is after the hyphen."""
    retrieval = options.retrieval
    calibrated = ""
    if retrieval.calibration is not None:
        calibrated = hashlib.sha256(
            read_whitening(Path(retrieval.calibration)).matrix.tobytes()
        ).hexdigest()
    compared = f"{retrieval.distance} {retrieval.whitening} {retrieval.shrinkage} {calibrated}"
    return f"{_digest(f'{FORMAT} {signatures_digest(options)} {compared}')}-{_digest(revision)}"


def _digest(text: str) -> str:
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
