"""The file formats by suffix: those of pcretrieve, and those of other packages."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import OptionError, ScanReadError, ShapeError, Stage
from pcretrieve.formats.arrays import NPY, NPZ
from pcretrieve.formats.conf import conf_format
from pcretrieve.formats.depth import DEPTH_IMAGE
from pcretrieve.formats.e57 import E57
from pcretrieve.formats.files import check_file
from pcretrieve.formats.format import Extra, Format
from pcretrieve.formats.gltf import GLB, GLTF
from pcretrieve.formats.las import LAS, LAZ
from pcretrieve.formats.members import MARK
from pcretrieve.formats.obj import OBJ
from pcretrieve.formats.off import OFF
from pcretrieve.formats.pcd import PCD
from pcretrieve.formats.ply import PLY
from pcretrieve.formats.ptx import PTX
from pcretrieve.formats.raw import RawScan
from pcretrieve.formats.scenes import COLLADA, THREE_MF
from pcretrieve.formats.stl import STL
from pcretrieve.formats.text_points import TEXT_FORMATS
from pcretrieve.formats.vrml import VRML
from pcretrieve.plugins import Names, Registry

__all__ = ["FORMATS", "format_of", "missing_extra", "read_raw", "reading", "split_member", "suffixes"]

# Largest number of names in a message.
MOST_QUOTED = 5


def suffixes() -> tuple[str, ...]:
    """The suffixes of all files that can be read, including those of other packages."""
    return FORMATS.names.all()


def missing_extra(suffix: str) -> Extra | None:
    """What must be installed, and is not, to read files of a suffix."""
    extra = FORMATS.own[suffix].extra if suffix in FORMATS.own else None
    return extra if extra is not None and extra.missing else None


def split_member(path: Path) -> tuple[Path, str | None]:
    """The file of a path, and the name of the scan in it, if the path names one of several."""
    file, mark, name = path.name.partition(MARK)
    if mark and name:
        suffix = Path(file).suffix.lower()
        if suffix in FORMATS.names.all() and format_of(suffix).members is not None:
            return path.with_name(file), name
    return path, None


def read_raw(path: Path) -> RawScan:
    """Read the arrays of a file.

    Returns RawScan: the arrays; unit of the file.
    """
    file, name = split_member(path)
    suffix = file.suffix.lower()
    if suffix not in FORMATS.names.all():
        name = f"in {path.suffix}" if suffix else "without a suffix"
        raise ScanReadError(f"there is no reader for names {name}, only for {' '.join(sorted(suffixes()))}")
    if extra := missing_extra(suffix):
        raise ScanReadError(
            f"reading {suffix} needs the package {' and '.join(extra.missing)}: {extra.command}"
        )
    try:
        check_file(file)
        found = format_of(suffix)
        with reading(suffix):
            scan = found.read(file) if name is None else _member(found, file, name)
            return scan if suffix in FORMATS.own else _checked(scan)
    except OSError as error:
        raise ScanReadError(f"cannot read {file}: {error.strerror or error}") from error


def _member(found: Format, file: Path, name: str) -> RawScan:
    if found.members is None:
        raise ScanReadError("the file is one scan, and has no scans with names")
    names = found.members.names(file)
    if name not in names:
        raise ScanReadError(f"the file must hold a scan {name!r}, got {', '.join(names[:MOST_QUOTED])}")
    return found.members.read(file, name)


def format_of(suffix: str) -> Format:
    """The format of a suffix."""
    try:
        return FORMATS[suffix]
    except OptionError as error:
        raise ScanReadError(error.message) from error


@contextmanager
def reading(suffix: str) -> Iterator[None]:
    """Turn the errors of a reader into errors of its file."""
    try:
        with FORMATS.blamed(suffix, Stage.READ):
            yield
    except ScanReadError:
        raise
    except ShapeError as error:
        raise ScanReadError(error.message) from error


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
    for found in (
        PLY,
        PCD,
        *TEXT_FORMATS,
        *(PTX, NPY, NPZ, LAS, LAZ, E57, DEPTH_IMAGE),
        OBJ,
        OFF,
        STL,
        GLB,
        GLTF,
        VRML,
        THREE_MF,
        COLLADA,
        conf_format(read_raw),
    )
    for suffix in found.suffixes
}

#: The formats by suffix. Other packages add formats by entry points of the group ``pcretrieve.readers``: the
#: name of an entry point is the suffix, including the dot, in lower case; its value is a `Format`, or a
#: function from a path to a `RawScan`.
FORMATS: Registry[Format] = Registry(Names("format", "pcretrieve.readers", tuple(_OWN)), _OWN, _added)
