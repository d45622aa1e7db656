"""Readers that other packages bring, by the entry-point group ``pcretrieve.readers``."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import ScanReadError
from pcretrieve.formats.raw import RawScan

__all__ = ["PluginReader"]


class PluginReader:
    """The reader that an entry point names, loaded when it is first used.

    Whatever is wrong with it is an error of the files that it should read, and of no others.

    Parameters
    ----------
    entry : EntryPoint
        Named by the suffix of its files, dot included; its value is a function from a path to a `RawScan`.
    """

    def __init__(self, entry: EntryPoint) -> None:
        self._entry = entry

    def __call__(self, path: Path) -> RawScan:
        """Read a file.

        Raises
        ------
        ScanReadError
            If the reader cannot be loaded, raises anything but a lack of memory, or gives no scan.
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
    """The arrays of a scan in the types and shapes that `RawScan` promises.

    Raises
    ------
    TypeError, ValueError
        If it is not a scan, or they cannot be had.
    """
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
