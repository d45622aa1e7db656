"""The file formats by suffix: those of pcretrieve, and those of other packages."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import OptionError, ScanReadError, ShapeError, Stage
from pcretrieve.formats.arrays import NPY, NPZ
from pcretrieve.formats.conf import conf_format
from pcretrieve.formats.files import check_file
from pcretrieve.formats.format import Extra, Format, Part
from pcretrieve.formats.glb import GLB
from pcretrieve.formats.obj import OBJ
from pcretrieve.formats.off import OFF
from pcretrieve.formats.pcd import PCD
from pcretrieve.formats.ply import PLY
from pcretrieve.formats.ptx import PTX
from pcretrieve.formats.raw import RawScan
from pcretrieve.formats.stl import STL
from pcretrieve.formats.text_points import TEXT_FORMATS
from pcretrieve.plugins import Names, Registry

__all__ = ["FORMATS", "is_scan", "missing_extra", "parts_of", "read_raw", "suffixes"]


def suffixes() -> tuple[str, ...]:
    """The suffixes of all files that can be read, including those of other packages.

    Returns
    -------
    tuple of str
        Including the dot, in lower case.
    """
    return FORMATS.names.all()


def missing_extra(suffix: str) -> Extra | None:
    """What must be installed, and is not, to read files of a suffix.

    Parameters
    ----------
    suffix : str
        Including the dot, in lower case.

    Returns
    -------
    Extra or None
        None if everything is installed, or the suffix is not one of pcretrieve's own formats.
    """
    extra = FORMATS.own[suffix].extra if suffix in FORMATS.own else None
    return extra if extra is not None and extra.missing else None


def is_scan(path: Path) -> bool:
    """Whether a file of a folder is a scan that can be read.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    bool
        Whether its suffix is that of a format, whose extra is installed, and which recognises the file where
        other files have the suffix too. A file that cannot be opened is a scan, so that reading it says why.
    """
    suffix = path.suffix.lower()
    if suffix not in FORMATS.names.all() or missing_extra(suffix):
        return False
    try:
        recognise = FORMATS[suffix].recognise
        if recognise is None:
            return True
        check_file(path)
        with FORMATS.blamed(suffix, Stage.READ):
            return recognise(path)
    except ScanReadError:
        return False  # a folder, a pipe or a device, or an empty file
    except (OSError, OptionError, ShapeError):
        return True


def parts_of(path: Path) -> tuple[Part, ...]:
    """The other files that belong to a file.

    Parameters
    ----------
    path : Path
        The file, of any suffix.

    Returns
    -------
    tuple of Part
        Empty, if the file is a scan alone.

    Raises
    ------
    OSError
        If the file cannot be read.
    ScanReadError
        If the file does not say which they are, or its reader cannot be loaded.
    """
    suffix = path.suffix.lower()
    if suffix not in FORMATS.names.all():
        return ()
    found = _format(suffix)
    try:
        with FORMATS.blamed(suffix, Stage.READ):
            return tuple(found.parts(path))
    except ShapeError as error:
        raise _as_read_error(error) from error


def read_raw(path: Path) -> RawScan:
    """Read the arrays of a file.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    RawScan
        The arrays; unit of the file.

    Raises
    ------
    MemoryError
        If the file is too large for the memory.
    ScanReadError
        If there is no format for the suffix, its reader cannot be loaded or fails, or the file cannot be
        read.
    """
    suffix = path.suffix.lower()
    if suffix not in FORMATS.names.all():
        name = f"in {path.suffix}" if suffix else "without a suffix"
        raise ScanReadError(f"there is no reader for names {name}, only for {' '.join(sorted(suffixes()))}")
    if extra := missing_extra(suffix):
        raise ScanReadError(
            f"reading {suffix} needs the package {' and '.join(extra.missing)}: {extra.command}"
        )
    try:
        check_file(path)
        found = _format(suffix)
        with FORMATS.blamed(suffix, Stage.READ):
            scan = found.read(path)
            return scan if suffix in FORMATS.own else _checked(scan)
    except OSError as error:
        raise ScanReadError(f"cannot read {path}: {error.strerror or error}") from error
    except ShapeError as error:
        raise _as_read_error(error) from error


def _format(suffix: str) -> Format:
    try:
        return FORMATS[suffix]
    except OptionError as error:
        raise ScanReadError(error.message) from error


def _as_read_error(error: ShapeError) -> ScanReadError:
    return error if isinstance(error, ScanReadError) else ScanReadError(error.message)


def _added(suffix: str, added: object) -> Format:
    """The format of another package, which may be a mere function that reads a file."""
    if isinstance(added, Format):
        return added
    if callable(added):
        return Format((suffix,), added)
    raise TypeError(f"must be a Format, or a function that reads a file, got {type(added).__name__}")


def _checked(scan: object) -> RawScan:
    """The scan with arrays of the types and shapes of `RawScan`; TypeError or ValueError if it has others."""
    if not isinstance(scan, RawScan):
        raise TypeError(f"a reader must return a RawScan, got {type(scan).__name__}")
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


_OWN = {
    suffix: found
    for found in (PLY, PCD, *TEXT_FORMATS, PTX, NPY, NPZ, OBJ, OFF, STL, GLB, conf_format(read_raw))
    for suffix in found.suffixes
}

#: The formats by suffix. Other packages add formats by entry points of the group ``pcretrieve.readers``: the
#: name of an entry point is the suffix, including the dot, in lower case; its value is a `Format`, or a
#: function from a path to a `RawScan`.
FORMATS: Registry[Format] = Registry(Names("format", "pcretrieve.readers", tuple(_OWN)), _OWN, _added)
