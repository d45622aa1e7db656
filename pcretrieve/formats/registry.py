"""The table of file formats by suffix, and what can be said of a file before it is read."""

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
from pcretrieve.formats.format import Extra, Format, Part, RawScan, check_file, url_of
from pcretrieve.formats.gltf import GLB, GLTF
from pcretrieve.formats.las import LAS, LAZ
from pcretrieve.formats.meshes import OBJ, OFF, STL
from pcretrieve.formats.pcd import PCD
from pcretrieve.formats.ply import PLY
from pcretrieve.formats.ptx import PTX
from pcretrieve.formats.scenes import COLLADA, THREE_MF
from pcretrieve.formats.text import TEXT_FORMATS
from pcretrieve.plugins import Names, Registry

# Separator between the name of a file and the name of a scan in it.
MARK = "#"
# Largest number of names in a message.
MOST_QUOTED = 5
# What to write instead of formats that programs export and that are not read.
INSTEAD = {".wrl": ".obj or .glb", ".vrml": ".obj or .glb", ".x3d": ".obj or .glb", ".fbx": ".glb"}


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
        if suffix in suffixes() and _format_of(suffix).names is not None:
            return path.with_name(file), name
    return path, None


def is_scan(path: Path) -> bool:
    """Whether a file of a folder is a scan that can be read."""
    suffix = path.suffix.lower()
    if suffix not in suffixes() or missing_extra(suffix):
        return False
    try:
        recognise = FORMATS[suffix].recognise
        if recognise is None:
            return True
        if url_of(path) is not None:
            return False  # only a copy of the file could be looked into
        check_file(path)
        with FORMATS.blamed(suffix, Stage.READ):
            return recognise(path)
    except ScanReadError:
        return False  # a folder, a pipe or a device, or an empty file
    except (OSError, OptionError, ShapeError):
        return True


def members_of(path: Path) -> tuple[Path, ...]:
    """The paths of the scans in a file; none if it is one scan."""
    suffix = path.suffix.lower()
    if suffix not in suffixes() or missing_extra(suffix):
        return ()
    found = _format_of(suffix)
    if found.names is None:
        return ()
    check_file(path)
    with _reading(suffix):
        names = found.names(path)
    return tuple(path.with_name(f"{path.name}{MARK}{name}") for name in names) if len(names) > 1 else ()


def parts_of(path: Path) -> tuple[Part, ...]:
    """The other files that belong to a file."""
    file, _ = split_member(path)
    suffix = file.suffix.lower()
    if suffix not in suffixes():
        return ()
    found = _format_of(suffix)
    with _reading(suffix):
        return tuple(found.parts(file))


def read_raw(path: Path) -> RawScan:
    """Read the arrays of a file, in its unit."""
    file, name = split_member(path)
    suffix = file.suffix.lower()
    if suffix not in suffixes():
        kind = f"in {path.suffix}" if suffix else "without a suffix"
        advice = f": export the scan as {INSTEAD[suffix]}" if suffix in INSTEAD else ""
        raise ScanReadError(
            f"there is no reader for names {kind}, only for {' '.join(sorted(suffixes()))}{advice}"
        )
    if extra := missing_extra(suffix):
        raise ScanReadError(
            f"reading {suffix} needs the package {' and '.join(extra.missing)}: {extra.command}"
        )
    try:
        check_file(file)
        found = _format_of(suffix)
        with _reading(suffix):
            scan = found.read(file) if name is None else _member(found, file, name)
            return scan if suffix in FORMATS.own else _checked(scan)
    except OSError as error:
        raise ScanReadError(f"cannot read {file}: {error.strerror or error}") from error


def _member(found: Format, file: Path, name: str) -> RawScan:
    names = found.names(file) if found.names is not None else ()
    if name not in names:
        raise ScanReadError(f"the file must hold a scan {name!r}, got {', '.join(names[:MOST_QUOTED])}")
    return found.read(file, name)


def _format_of(suffix: str) -> Format:
    try:
        return FORMATS[suffix]
    except OptionError as error:
        raise ScanReadError(error.message) from error


@contextmanager
def _reading(suffix: str) -> Iterator[None]:
    """Turn the errors of a reader into errors of its file."""
    try:
        with FORMATS.blamed(suffix, Stage.READ):
            yield
    except ScanReadError:
        raise
    except ShapeError as error:
        raise ScanReadError(error.message) from error


# --- formats of other packages ----------------------------------------------------------------------------


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
        *(PLY, PCD, *TEXT_FORMATS, PTX, NPY, NPZ, LAS, LAZ, E57, DEPTH_IMAGE),
        *(OBJ, OFF, STL, GLB, GLTF, THREE_MF, COLLADA, conf_format(read_raw)),
    )
    for suffix in found.suffixes
}

#: The formats by suffix. Other packages add formats by entry points of the group ``pcretrieve.readers``: the
#: name of an entry point is the suffix, including the dot, in lower case; its value is a `Format`, or a
#: function from a path to a `RawScan`.
FORMATS: Registry[Format] = Registry(Names("format", "pcretrieve.readers", tuple(_OWN)), _OWN, _added)
