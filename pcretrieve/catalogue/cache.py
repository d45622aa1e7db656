"""Cache of the indexes and maps of a catalogue, as arrays that are mapped into memory.

An index of a million shapes takes seconds to compute and milliseconds to open. It is stored in a folder
beside the file of the catalogue, ``bodies.sqlite.gallery``, or in the cache folder of the user if that folder
cannot be written. It belongs to one state of the catalogue. The folder may be deleted.
"""

from __future__ import annotations

import hashlib
import json
import logging
import math
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

from pcretrieve.options import PipelineOptions, fused_names
from pcretrieve.plugins import METHODS
from pcretrieve.retrieval import SignatureIndex
from pcretrieve.retrieval.clusters import plane_map
from pcretrieve.retrieval.whitening import read_whitening
from pcretrieve.values import FloatArray

logger = logging.getLogger(__name__)

# Version of the arrays of an index, which is incremented when their meaning changes.
FORMAT = 10

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
        for folder in self._folders:
            for kept in sorted(folder.iterdir()) if folder.is_dir() else ():
                try:
                    if not kept.name.startswith(UNFINISHED):
                        _arrays(kept, checked=math.inf)
                except FileNotFoundError:
                    continue  # another process removes it at this moment
                except Exception as error:  # noqa: BLE001  as in `_opened`
                    yield kept, f"cannot be read: {error}"

    def _opened(self, name: str, read: Callable[[dict[str, NDArray[Any]]], Any]) -> Any:
        """What `read` makes of stored arrays; None if there are none."""
        for folder in self._folders:
            kept = folder / name
            try:
                return read(_arrays(kept))
            except FileNotFoundError:
                continue  # there is none, or another process removes it at this moment
            # NumPy reads the header of an array by parsers of Python, and lets their exceptions pass.
            except Exception as error:  # noqa: BLE001
                logger.warning("computed again, because it cannot be read: %s (%s)", kept, error)
                shutil.rmtree(kept, ignore_errors=True)
        return None

    def _keep(self, name: str, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Store arrays in the first folder that can be written, and remove those of other states."""
        for folder in self._folders:
            try:
                folder.mkdir(parents=True, exist_ok=True)
                _write(folder, name, arrays)
                _tidy(folder, name)
                return
            except OSError as error:
                logger.info("an index is not stored in %s: %s", folder, error)


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
        unfinished.chmod(0o755)
        unfinished.rename(folder / name)
    except OSError:
        if not (folder / name).is_dir():  # another process was faster
            raise
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def _tidy(folder: Path, name: str) -> None:
    """Remove indexes of other states than that of `name`, and incomplete folders of killed processes."""
    for kept in folder.iterdir():
        if kept.name.startswith(UNFINISHED):
            stale = kept.stat().st_mtime < time.time() - ABANDONED
        else:
            stale = kept.name.rpartition("-")[2] != name.rpartition("-")[2]
        if stale:
            shutil.rmtree(kept, ignore_errors=True)
