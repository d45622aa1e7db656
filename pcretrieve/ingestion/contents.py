"""Files → hashes of their contents, ahead of whoever asks for them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

from pcretrieve.errors import ShapeError
from pcretrieve.ingestion.discover import content_hash

__all__ = ["Contents"]


class Contents:
    """Hashes of files, each computed once: in threads for the files that are expected, or when asked for.

    Parameters
    ----------
    files : mapping of str to Path
        Each by the name that it is asked for.
    n_threads : int
        Files that are read at a time. Hashing and reading release the interpreter lock.
    """

    def __init__(self, files: Mapping[str, Path], n_threads: int) -> None:
        self._files = files
        self._pool = ThreadPoolExecutor(n_threads)
        self._expected: dict[str, Future[str | ShapeError]] = {}
        self._known: dict[str, str | ShapeError] = {}

    def expect(self, names: Iterable[str]) -> None:
        """Begin to hash files in the background."""
        for name in names:
            if name not in self._known and name not in self._expected:
                self._expected[name] = self._pool.submit(_content, self._files[name])

    def of(self, name: str) -> str | ShapeError:
        """SHA-256 of a file, or why it cannot be read."""
        if name not in self._known:
            self.expect([name])
            self._known[name] = self._expected.pop(name).result()
        return self._known[name]

    def close(self) -> None:
        """Hash no more files."""
        self._pool.shutdown(wait=False, cancel_futures=True)


def _content(path: Path) -> str | ShapeError:
    try:
        return content_hash(path)
    except ShapeError as error:
        return error
