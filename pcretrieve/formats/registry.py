"""The table of file formats by suffix, and what can be said of a file before it is read."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from errno import EINVAL
from functools import partial
from pathlib import Path
from typing import Any

from pcretrieve.errors import OptionError, ScanReadError, ShapeError, Stage
from pcretrieve.formats import meshes
from pcretrieve.formats.arrays import (
    parts_of_npy,
    read_npy,
    read_npz,
    recognise_npy,
    recognise_npz,
)
from pcretrieve.formats.conf import conf_views, read_conf
from pcretrieve.formats.depth import camera_parts, is_depth_image, read_depth
from pcretrieve.formats.format import (
    DECIMAL_COMMA,
    Cut,
    Extra,
    Format,
    Part,
    RawScan,
    check_file,
    checked,
)
from pcretrieve.formats.gltf import buffer_files, gltf_scene
from pcretrieve.formats.laser import LAZRS, e57_names, read_e57, read_las
from pcretrieve.formats.pcd import pcd_bytes, read_pcd
from pcretrieve.formats.ply import ply_bytes, read_ply
from pcretrieve.formats.text import is_table, ptx_names, read_ptx, read_text, xyzn_bytes
from pcretrieve.plugins import Names, Registry
from pcretrieve.values.files import check_members

# A protocol has two letters at least, unlike the drives of Windows.
PROTOCOL = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+):(/.*)", re.DOTALL)
# The protocol of files on this computer, whose paths are absolute.
FILE = "file"
# Separator between the name of a file and the name of a scan in it.
MARK = "#"
# Largest number of names in a message.
MOST_QUOTED = 5
ARCHIVES = (".zip", ".gz", ".tgz", ".tar", ".bz2", ".xz", ".zst", ".7z", ".rar")
# What other programs write instead, for formats without a specification or a reader that is free.
EXPORTS = {
    ".glb": ".fbx .blend .usd .usda .usdc .usdz .abc .max .ma .mb .c4d .3ds",
    ".obj or .glb": ".wrl .vrml .x3d",
    ".stl": ".step .stp .iges .igs .sldprt .sldasm .ipt .3dm .f3d .x_t .brep",
    ".e57": ".fls .fws .zfs .zfprj .rcp .rcs .rdbx .imp .lgs",
    ".ply": ".vtk .vtp .vtu .ctm .nvm .mesh .wrp",
}
INSTEAD = {
    suffix: f"export it as {target}"
    for target, suffixes in EXPORTS.items()
    for suffix in suffixes.split()
} | dict.fromkeys(ARCHIVES, "unpack it first")


@dataclass(frozen=True, slots=True)
class ScanPath:
    """Where a scan is, written ``file``, ``file#name`` or as a URL. It is made once, where a path comes in.

    Attributes
    ----------
    file : Path
        The file; of a URL, the path that Python makes of it.
    member : str or None
        The name of the scan, if it is one of several in the file.
    url : str or None
        The URL of the file; None if the file is on this computer.
    """

    file: Path
    member: str | None = None
    url: str | None = None

    @classmethod
    def parse(cls, given: str | Path | ScanPath) -> ScanPath:
        """The place that a text names. The sign # is a part of names of files that hold one scan."""
        if isinstance(given, ScanPath):
            return given
        path = Path(given)
        name, _, member = path.name.partition(MARK)
        # Nothing, and a point, are no names of files.
        if name.strip(".") and member:
            found = _format_of(path.with_name(name))
            if found is not None and found.names is not None:
                path = path.with_name(name)
                return cls(path, member, _url_of(path))
        return cls(path, None, _url_of(path))

    def __str__(self) -> str:
        file = self.url or str(self.file)
        return file if self.member is None else f"{file}{MARK}{self.member}"

    @property
    def name(self) -> str:
        """The name of the file, and that of the scan in it."""
        return str(ScanPath(Path(self.file.name), self.member))

    @property
    def suffix(self) -> str:
        """The suffix of the file in lower case, which says how it is read."""
        return self.file.suffix.lower()

    @property
    def whole(self) -> ScanPath:
        """All scans of the file."""
        return replace(self, member=None)


def _url_of(path: Path) -> str | None:
    """The URL that a path was made of: a `Path` keeps one of the two slashes after the protocol."""
    found = PROTOCOL.fullmatch(str(path))
    if found is None:
        return None
    protocol, rest = found.groups()
    return f"{protocol}:/{'/' if protocol == FILE else ''}{rest}"


def suffixes() -> tuple[str, ...]:
    """The suffixes of all files that can be read, including those of other packages."""
    return FORMATS.names.all()


def missing_extra(suffix: str) -> Extra | None:
    """What must be installed, and is not, to read files of a suffix."""
    extra = FORMATS.own[suffix].extra if suffix in FORMATS.own else None
    return extra if extra is not None and extra.missing else None


def is_scan(scan: ScanPath) -> bool:
    """Whether a file of a folder is a scan that can be read."""
    file = scan.file
    suffix = scan.suffix
    if suffix not in suffixes() or missing_extra(suffix):
        return False
    try:
        recognise = FORMATS[suffix].recognise
        if recognise is None:
            return True
        if scan.url is not None:
            return False  # only a copy of the file could be looked into
        check_file(file)
        with FORMATS.blamed(suffix, Stage.READ), _damage(file):
            return recognise(file)
    except ScanReadError:
        return False  # a folder, a pipe or a device, or an empty or damaged file
    except (OSError, OptionError, ShapeError):
        return True


def members_of(file: Path) -> tuple[ScanPath, ...]:
    """The scans in a file; none if it is one scan."""
    found = _format_of(file)
    if found is None or found.names is None or missing_extra(file.suffix.lower()):
        return ()
    check_file(file)
    with _reading(file):
        names = found.names(file)
        check_members(len(names))
    return tuple(ScanPath(file, name) for name in names) if len(names) > 1 else ()


def parts_of(file: Path) -> tuple[Part, ...]:
    """The other files that belong to a file."""
    found = _format_of(file)
    if found is None:
        return ()
    with _reading(file):
        return tuple(found.parts(file))


def read_raw(scan: ScanPath) -> RawScan:
    """Read the arrays of a file on this computer, in its unit."""
    file = scan.file
    name = scan.member
    suffix = scan.suffix
    found = _format_of(file)
    if found is None:
        kind = f"in {file.suffix}" if suffix else "without a suffix"
        advice = f": {INSTEAD[suffix]}" if suffix in INSTEAD else ""
        raise ScanReadError(
            f"there is no reader for names {kind}, only for {' '.join(sorted(suffixes()))}{advice}"
        )
    if extra := missing_extra(suffix):
        raise ScanReadError(
            f"reading {suffix} needs the package {' and '.join(extra.missing)}: {extra.command}"
        )
    try:
        check_file(file)
        with _reading(file):
            if name is None:
                raw = found.read(file)
            else:
                names = found.names(file) if found.names is not None else ()
                if name not in names:
                    quoted = ", ".join(names[:MOST_QUOTED])
                    raise ScanReadError(
                        f"the file must hold a scan {name!r}, got {quoted}"
                    )
                raw = found.read(file, name)
            return raw if suffix in FORMATS.own else checked(raw)
    except OSError as error:
        raise ScanReadError(f"cannot read {file}: {error.strerror or error}") from error


def _format_of(file: Path) -> Format | None:
    """The format of the suffix of a file."""
    suffix = file.suffix.lower()
    try:
        return FORMATS[suffix] if suffix in suffixes() else None
    except OptionError as error:
        raise ScanReadError(error.message) from error


@contextmanager
def _reading(file: Path) -> Iterator[None]:
    """Turn the errors of a reader into errors of its file."""
    suffix = file.suffix.lower()
    try:
        with FORMATS.blamed(suffix, Stage.READ), _damage(file):
            yield
    except ScanReadError:
        raise
    except ShapeError as error:
        raise ScanReadError(error.message) from error


@contextmanager
def _damage(file: Path) -> Iterator[None]:
    """Report what a reader of pcretrieve, or its library, raises for a damaged file: any exception."""
    try:
        yield
    except (MemoryError, ShapeError):
        raise
    except Exception as error:
        # Of a place before the file, to which a damaged number leads, the system says EINVAL.
        is_of_system = isinstance(error, OSError) and error.errno != EINVAL
        if is_of_system or file.suffix.lower() not in FORMATS.own:
            raise
        reason = str(error).partition("\n")[0]
        if isinstance(error, UnicodeError):
            reason = "it holds bytes that are no text"
        elif isinstance(error, struct.error):
            reason = "its header is cut short"
        elif not reason or isinstance(error, _OF_VALUES):
            reason = f"{type(error).__name__} {reason}".strip()
        kind = file.suffix[1:].upper()
        if isinstance(error, (Cut, struct.error)):
            said = f"not a complete {kind} file ({reason}): export or copy it again"
        elif DECIMAL_COMMA.search(reason):
            said = f"not a valid {kind} file ({reason}): export it with decimal points, not commas"
        else:
            said = f"not a valid {kind} file ({reason}): export it again, or in another format"
        raise ScanReadError(said) from error


# Exceptions whose message says nothing without their name, of headers and trees that lack something.
_OF_VALUES = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError)


# --- formats of other packages ----------------------------------------------------------------------------


def _added(suffix: str, added: object) -> Format:
    """The format of another package, which may be a mere function that reads a file."""
    if isinstance(added, Format):
        return added
    if callable(added):
        return Format(added)
    raise TypeError(
        f"must be a Format, or a function that reads a file, got {type(added).__name__}"
    )


# --- the table --------------------------------------------------------------------------------------------


def _scene(read: Callable[[Path], meshes.Scene], **others: Any) -> Format:
    def names(path: Path) -> tuple[str, ...]:
        return tuple(first for first, *_ in meshes.scene_bodies(read, path))

    return Format(partial(meshes.read_scene, read), names=names, **others)


# Columns behind the coordinates of tables without a header are colours and intensities, by the suffix.
_POINTS = Format(partial(read_text, normals=False))
# Files of these suffixes hold other tables and texts, or pictures, too.
_TABLE = Format(read_text, recognise=is_table)
_IMAGE = Format(read_depth, camera_parts, recognise=is_depth_image)
_OWN = {
    ".ply": Format(
        read_ply,
        write_cloud=ply_bytes,
        write_mesh=partial(meshes.mesh_bytes, file_type="ply"),
    ),
    ".pcd": Format(read_pcd, write_cloud=pcd_bytes),
    **dict.fromkeys((".xyz", ".xyzrgb", ".pts"), _POINTS),
    ".xyzn": Format(partial(read_text, normals=True), write_cloud=xyzn_bytes),
    **dict.fromkeys((".asc", ".csv", ".txt"), _TABLE),
    ".ptx": Format(read_ptx, names=ptx_names),
    ".npy": Format(read_npy, parts_of_npy, recognise=recognise_npy),
    ".npz": Format(read_npz, recognise=recognise_npz),
    ".las": Format(read_las),
    ".laz": Format(read_las, extra=LAZRS),
    ".e57": Format(read_e57, names=e57_names, extra=Extra("e57", ("pye57",))),
    **dict.fromkeys((".png", ".tif", ".tiff"), _IMAGE),
    ".obj": Format(
        meshes.read_obj, write_mesh=partial(meshes.mesh_bytes, file_type="obj")
    ),
    ".off": Format(
        meshes.read_off, write_mesh=partial(meshes.mesh_bytes, file_type="off")
    ),
    ".stl": Format(
        meshes.read_stl, write_mesh=partial(meshes.mesh_bytes, file_type="stl")
    ),
    ".glb": _scene(gltf_scene, write_mesh=partial(meshes.mesh_bytes, file_type="glb")),
    ".gltf": _scene(gltf_scene, parts=buffer_files),
    ".3mf": _scene(meshes.three_mf_scene, extra=Extra("meshes", ("lxml",))),
    ".dae": _scene(meshes.collada_scene, extra=Extra("meshes", ("collada",))),
    ".conf": Format(
        partial(read_conf, read_view=lambda view: read_raw(ScanPath.parse(view))),
        conf_views,
    ),
}

#: The formats by suffix. Other packages add formats by entry points of the group ``pcretrieve.readers``: the
#: name of an entry point is the suffix, including the dot, in lower case; its value is a `Format`, or a
#: function from a path to a `RawScan`.
FORMATS: Registry[Format] = Registry(
    Names("format", "pcretrieve.readers", tuple(_OWN)), _OWN, _added
)
