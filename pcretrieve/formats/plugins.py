"""Readers of other packages, from the entry-point group ``pcretrieve.readers``."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import ScanReadError
from pcretrieve.formats.raw import RawScan

__all__ = ["PluginReader"]


class PluginReader:
    """The reader of an entry point, which is loaded at its first use.

    An error in the reader is reported for the files of its suffix only.

    Parameters
    ----------
    entry : EntryPoint
        Its name is the suffix of the files, including the dot, and its value is a function from a path to a
        `RawScan`.
    """

    def __init__(self, entry: EntryPoint) -> None:
        self._entry = entry

    def __call__(self, path: Path) -> RawScan:
        """Read a file.

        Parameters
        ----------
        path : Path
            The file.

        Returns
        -------
        RawScan
            The arrays of the file, with checked types and shapes.

        Raises
        ------
        ScanReadError
            If the reader cannot be loaded, raises an exception, or does not return a valid `RawScan`.
        """
        try:
            read = self._entry.load()
        except (Exception, SystemExit) as error:  # another package may raise anything
            raise self._failure("cannot be loaded", error) from error
        try:
            return _checked(read(path))
        except (ScanReadError, OSError, MemoryError):
            raise
        except (Exception, SystemExit) as error:
            raise self._failure("failed", error) from error

    def _failure(self, what: str, error: BaseException) -> ScanReadError:
        entry, dist = self._entry, self._entry.dist
        package = f" of the package {dist.name} {dist.version}" if dist is not None else ""
        return ScanReadError(
            f"the reader of {entry.name} files, {entry.value}{package}, {what} "
            f"({type(error).__name__}: {error}): update or uninstall it, or tell its authors"
        )


def _checked(scan: object) -> RawScan:
    """The scan with arrays of the types and shapes of `RawScan`; TypeError or ValueError if it has others."""
    if not isinstance(scan, RawScan):
        raise TypeError(f"a reader must give a RawScan, got {type(scan).__name__}")
    points = _rows(scan.points, "points")
    faces = None if scan.faces is None else _rows(scan.faces, "faces")
    if faces is not None and not np.array_equal(faces, np.rint(faces)):
        raise ValueError("faces must be whole numbers")
    normals = None if scan.normals is None else _rows(scan.normals, "normals", len(points))
    viewpoints = scan.viewpoints
    if viewpoints is not None and np.shape(viewpoints) != (3,):
        viewpoints = _rows(viewpoints, "viewpoints", len(points))
    return RawScan(
        points, None if faces is None else faces.astype(np.int64), normals, viewpoints, tuple(scan.notes)
    )


def _rows(array: object, name: str, n: int | None = None) -> NDArray[np.float64]:
    rows = np.asarray(array, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != 3 or n not in (None, len(rows)):
        raise ValueError(f"{name} must have the shape ({'n' if n is None else n}, 3), got {rows.shape}")
    return rows
