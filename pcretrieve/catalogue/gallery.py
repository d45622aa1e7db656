"""The indexes of a catalogue's signatures, kept as arrays that are mapped into memory.

An index of a million shapes takes seconds to make and milliseconds to open. It is kept in a folder beside the
catalogue's file, ``bodies.sqlite.gallery``, or in the user's cache folder where that cannot be written. It
belongs to one state of the catalogue, and is made anew after a change. Nothing is lost with the folder.
"""

from __future__ import annotations

import hashlib
import logging
import os
import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcretrieve.catalogue.rows import Revision
from pcretrieve.retrieval import SignatureIndex

__all__ = ["Gallery"]

logger = logging.getLogger(__name__)

# Raised when the arrays of an index change their meaning.
FORMAT = 1

# Shapes below which an index is made anew by every process: that takes no longer than to open it.
SMALLEST_KEPT = 10_000

# Arrays of at least so many bytes are mapped into memory; smaller ones are read.
MAPPED = 2**16

# How a folder is called before it is complete, and after how many seconds it is taken for that of a process
# that was killed.
UNFINISHED = ".unfinished-"
ABANDONED = 3600.0


class Gallery:
    """The kept indexes of one catalogue; several processes may use them at once.

    Parameters
    ----------
    location : str
        The path or the URL of the catalogue.
    folder : Path, optional
        Where the indexes are kept. Where it cannot be written, or is None, they are kept in the user's cache
        folder.
    """

    def __init__(self, location: str, folder: Path | None) -> None:
        self._folders = (*([folder] if folder else []), *_cache_folder(location, folder))
        self._last: tuple[str, SignatureIndex] | None = None

    def index(
        self,
        request: str,
        revision: Revision,
        make: Callable[[], tuple[SignatureIndex, Revision]],
        *,
        by_label: bool,
    ) -> SignatureIndex:
        """The index for a request in a state of the catalogue, which was kept or is made now.

        Parameters
        ----------
        request : str
            What the index depends on beside the shapes.
        revision : Revision
            The state of the catalogue.
        make : function that returns an index and a Revision
            Makes the index. The state that it returns may be a later one.
        by_label : bool
            Whether the index depends on the labels of the shapes.

        Returns
        -------
        SignatureIndex
            Its arrays are mapped into memory where they were kept.
        """
        request = f"{FORMAT} {request}"
        name = _name(request, revision.state(by_label))
        if self._last is None or self._last[0] != name:
            index = self._opened(name)
            if index is None:
                index, revision = make()
                name = _name(request, revision.state(by_label))
                if len(index) >= SMALLEST_KEPT:
                    self._keep(name, revision, index)
                    # The arrays in memory are given back.
                    index = self._opened(name) or index
            self._last = name, index
        return self._last[1]

    def _opened(self, name: str) -> SignatureIndex | None:
        for folder in self._folders:
            kept = folder / name
            try:
                return SignatureIndex.from_arrays(_arrays(kept))
            except FileNotFoundError:
                continue  # none, or another process removes it just now
            except (OSError, ValueError, EOFError) as error:
                logger.warning("made anew, since it cannot be read: %s (%s)", kept, error)
                shutil.rmtree(kept, ignore_errors=True)
        return None

    def _keep(self, name: str, revision: Revision, index: SignatureIndex) -> None:
        """Keep an index in the first folder that can be written, and remove those of other states."""
        for folder in self._folders:
            try:
                folder.mkdir(parents=True, exist_ok=True)
                _write(folder, name, index.to_arrays())
                _tidy(folder, revision)
                return
            except OSError as error:
                logger.info("an index is not kept in %s: %s", folder, error)


def _name(request: str, state: str) -> str:
    return f"{_digest(request)}-{_digest(state)}"


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _cache_folder(location: str, folder: Path | None) -> Iterator[Path]:
    """The folder of a catalogue in the user's cache, where there is a user."""
    try:
        cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    except RuntimeError:
        return
    # The folder tells two files of one name in several working directories apart.
    name = str(folder.absolute()) if folder else location
    yield cache / "pcretrieve" / f"{Path(location).name}-{_digest(name)}"


def _arrays(folder: Path) -> dict[str, NDArray[Any]]:
    files = sorted(folder.iterdir())
    return {
        file.stem: np.load(file, mmap_mode="r" if file.stat().st_size >= MAPPED else None, allow_pickle=False)
        for file in files
    }


def _write(folder: Path, name: str, arrays: Mapping[str, NDArray[Any]]) -> None:
    """All arrays under that name, or none: a name is given to them once they are on the disk."""
    unfinished = Path(mkdtemp(prefix=UNFINISHED, dir=folder))
    try:
        for array_name, array in arrays.items():
            with (unfinished / f"{array_name}.npy").open("xb") as file:
                np.save(file, array, allow_pickle=False)
                file.flush()
                os.fsync(file.fileno())
        unfinished.chmod(0o755)
        unfinished.rename(folder / name)
    except FileExistsError:
        pass
    except OSError:
        if not (folder / name).is_dir():  # another process was faster
            raise
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def _tidy(folder: Path, revision: Revision) -> None:
    """Remove indexes of other states, and what killed processes left."""
    current = {_digest(revision.state(by_label)) for by_label in (False, True)}
    for kept in folder.iterdir():
        unfinished = kept.name.startswith(UNFINISHED)
        if unfinished:
            stale = kept.stat().st_mtime < time.time() - ABANDONED
        else:
            stale = kept.name.rpartition("-")[2] not in current
        if stale:
            shutil.rmtree(kept, ignore_errors=True)
