"""The record of a file format, the arrays of one file, and what readers share."""

from __future__ import annotations

import codecs
import re
import stat
import warnings
from collections.abc import Callable, Iterable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import ScanReadError
from pcretrieve.values import METRES, FloatArray, PointCloud, TriangleMesh
from pcretrieve.values.base import numbers

# Tolerance of the length of normals that a file does not name: they may have three digits.
UNIT_TOLERANCE = 1e-2

# Names of columns in files that are written: of points, of normals in PLY files, and of sensors, by PCL.
POINT_FIELDS = "x y z"
NORMAL_FIELDS = "nx ny nz"
SENSOR_FIELDS = "vp_x vp_y vp_z"

# Names of columns in files that are read, in lower case. "x_coord", "points_0" and "points:0" (ParaView);
# "nx" (MeshLab), "normal_x" (PCL), "normalx" (PDAL), "normals:0" (ParaView); "vp_x" (PCL).
COORDINATE = re.compile(r"(?:points?[_:.])?([xyz]|(?<=[_:.])[012])(?:[_ ]?coord\w*)?")
NORMAL = re.compile(r"(?:n|normals?[_:.]?)([xyz]|(?<=[_:.])[012])")
SENSOR = re.compile(r"vp_([xyz])")

# What the C library of Microsoft prints for NaN and for infinity: -nan(ind), 1.#QNAN, -1.#IND00, 1.#INF.
NO_NUMBER = re.compile(r"[+-]?(?:nan\(\w*\)|1\.#(?:[qs]nan|ind|inf)\d*)", re.IGNORECASE)
# A number whose decimal point is a comma.
DECIMAL_COMMA = re.compile(r"\d+,\d+")

# Largest compression ratio of deflate, the usual method of archives and of images.
DEFLATE_RATIO = 1032

# Characters that a path must not have, and the mark between the name of a file and that of a scan in it.
UNSAFE = re.compile(r"[\x00-\x1f\x7f/\\#]+")
# Longest name of a scan in a file; file systems allow 255 bytes for the name of a file.
LONGEST = 80


class RawScan(NamedTuple):
    """The arrays of one file, in its unit.

    Attributes
    ----------
    points : (n, 3) float
        Coordinates, which may be NaN or infinite.
    faces : (m, 3) int or None
        Vertex numbers of triangles; None for a point cloud.
    normals : (n, 3) float or None
        Normals, of any length.
    viewpoints : (n, 3) or (3,) float or None
        Positions of the sensors of all points, or of one sensor, in the frame of the points.
    notes : tuple of str
        Notes of the reader for the provenance.
    unit : str or None
        The unit of length of the file, a key of `METRES`; None if the file does not say.
    is_assumed : bool
        Whether `unit` is only that of most files of the format, for which an option may give another.
    """

    points: NDArray[Any]
    faces: NDArray[Any] | None = None
    normals: NDArray[Any] | None = None
    viewpoints: NDArray[Any] | None = None
    notes: tuple[str, ...] = ()
    unit: str | None = None
    is_assumed: bool = False


class Damaged(Exception):
    """A file is damaged, or not of the format of its suffix; the reason only, for `read_raw`."""


class Cut(Damaged):
    """A file ends before all that it declares."""


class Extra(NamedTuple):
    """The extra of pcretrieve that must be installed for a format, and its modules."""

    name: str
    modules: tuple[str, ...]

    @property
    def command(self) -> str:
        """The command that installs the extra."""
        return f"pip install 'pcretrieve[{self.name}]'"

    @property
    def missing(self) -> tuple[str, ...]:
        """The modules that are not installed."""
        return tuple(module for module in self.modules if find_spec(module) is None)


class Part(NamedTuple):
    """A file that belongs to another file.

    pose: (4, 4) float64 or None, rigid motion from the frame of the part to the frame of the scan, if the
        part is a view; in the unit of the file.
    """

    path: Path
    pose: FloatArray | None = None


def no_parts(path: Path) -> tuple[Part, ...]:
    """The parts of files of most formats."""
    return ()


class Format(NamedTuple):
    """A file format. Any of its functions may raise ScanReadError, or OSError of a file that cannot be read.

    Attributes
    ----------
    read : function of Path that returns a RawScan
        Reads a file, which exists, is a regular file and is not empty.
    parts : function of Path that returns a tuple of Part
        The other files that belong to a file: its content is that of all of them, and they are no scans of
        their own. None by default.
    write_cloud, write_mesh : function of PointCloud, of TriangleMesh, that returns bytes, or None
        The content of a file; None if the format does not store point clouds, or meshes. Raises InputError if
        a cloud lacks what the format requires.
    recognise : function of Path that returns a bool, or None
        Whether a file is a scan, by a look at its first bytes; for suffixes that other files have too. A
        folder stands for those files in it that are recognised. None if every file of the suffix is a scan.
    names : function of Path that returns a tuple of str, or None
        The names of the scans in a file: `read` takes one of them as its second argument, and reads all of
        them as one without it. None if a file is one scan.
    extra : Extra or None
        What must be installed to read the format; None if nothing more than pcretrieve.
    """

    read: Callable[..., RawScan]
    parts: Callable[[Path], tuple[Part, ...]] = no_parts
    write_cloud: Callable[[PointCloud], bytes] | None = None
    write_mesh: Callable[[TriangleMesh], bytes] | None = None
    recognise: Callable[[Path], bool] | None = None
    names: Callable[[Path], tuple[str, ...]] | None = None
    extra: Extra | None = None


# --- files ------------------------------------------------------------------------------------------------


def check_file(path: Path) -> None:
    """Check that a path is a regular file with content: opening a pipe would wait for a writer."""
    status = path.stat()
    if stat.S_ISDIR(status.st_mode):
        raise ScanReadError(f"{path} is a folder, not a scan")
    if not stat.S_ISREG(status.st_mode):
        raise ScanReadError(
            f"{path} must be a regular file, not a pipe or a device: save the scan to a file"
        )
    if not status.st_size:
        raise ScanReadError("the file is empty: scan or export it again")


def encoding_of(head: bytes) -> str:
    """The encoding of a text: names in any other one are read with wrong signs, numbers as they are."""
    is_wide = head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    return "utf-16" if is_wide else "utf-8-sig"


def text_lines(path: Path) -> list[str]:
    """The lines of a text file, whose names may be in any encoding."""
    data = path.read_bytes()
    text = data.decode(encoding_of(data), errors="replace")
    check_text(path, text)
    return NO_NUMBER.sub("nan", text).splitlines()


def check_text(path: Path, text: str) -> None:
    """Check that a file is a text file, as its suffix says: text has no zeros."""
    if "\0" in text:
        raise ScanReadError(f"not a text file, though its name ends in {path.suffix}")


def distinct_names(names: Iterable[str]) -> list[str]:
    """Convert the names of the scans in a file to distinct names that can be parts of a path."""
    found: dict[str, None] = {}
    counts: dict[str, int] = {}
    for number, name in enumerate(names, start=1):
        plain = UNSAFE.sub("_", name).strip()[:LONGEST].strip("_ ") or str(number)
        distinct = plain
        while distinct in found:
            counts[plain] = counts.get(plain, 1) + 1
            distinct = f"{plain}-{counts[plain]}"
        found[distinct] = None
    return list(found)


# --- arrays -----------------------------------------------------------------------------------------------


def numbers_in(text: str, what: str) -> NDArray[np.float64]:
    """The numbers of a text, between which are blanks and ends of lines."""
    try:
        with warnings.catch_warnings():
            # Before numpy 2.3 it was no error.
            warnings.simplefilter("error", DeprecationWarning)
            return np.fromstring(NO_NUMBER.sub("nan", text), sep=" ")
    except (ValueError, DeprecationWarning) as error:
        comma = DECIMAL_COMMA.search(text)
        such = f", such as {comma[0]}" if comma else ""
        raise Damaged(f"its {what} hold more than numbers{such}") from error


def are_normals(vectors: NDArray[Any]) -> bool:
    """Whether (n, 3) columns of a table are normals: of unit length, and unlike colours some negative."""
    vectors = vectors[np.isfinite(vectors).all(axis=1)]
    return bool(
        len(vectors)
        and (vectors < 0).any()
        and (np.abs(np.linalg.norm(vectors, axis=1) - 1) < UNIT_TOLERANCE).all()
    )


def checked(scan: object) -> RawScan:
    """The scan with arrays of the types and shapes of `RawScan`; TypeError or ValueError if it has others."""
    if not isinstance(scan, RawScan):
        raise TypeError(f"a reader must return a RawScan, got {type(scan).__name__}")
    arrays: dict[str, Any] = {}
    for name in ("points", "faces", "normals", "viewpoints"):
        if (given := getattr(scan, name)) is None:
            continue
        array = arrays[name] = numbers(name, given).astype(np.float64, copy=False)
        n = "n" if name in ("points", "faces") else len(arrays["points"])
        wanted = array.ndim == 2 and array.shape[1] == 3 and n in ("n", len(array))
        if not wanted and not (name == "viewpoints" and array.shape == (3,)):
            raise ValueError(f"{name} must have the shape ({n}, 3), got {array.shape}")
    if (faces := arrays.get("faces")) is not None:
        if (faces % 1).any():
            raise ValueError("faces must be whole numbers")
        arrays["faces"] = faces.astype(np.int64)
    if scan.unit not in (None, *METRES):
        raise ValueError(
            f"the unit must be one of {', '.join(METRES)}, got {scan.unit!r}"
        )
    return scan._replace(notes=tuple(scan.notes), **arrays)


def without_zeros(scan: RawScan) -> RawScan:
    """Drop the readings that a sensor without an answer has written as zeros."""
    missing = (scan.points == 0).all(axis=1)  # (n,)
    n_missing = int(missing.sum())
    if n_missing < 2 or n_missing == len(missing):
        return scan
    sensors = scan.viewpoints
    note = f"dropped {n_missing} of {len(missing)} points at zero: readings without an answer"
    return scan._replace(
        points=scan.points[~missing],
        normals=None if scan.normals is None else scan.normals[~missing],
        viewpoints=sensors if sensors is None or sensors.ndim == 1 else sensors[~missing],
        notes=(*scan.notes, note),
    )


def joined(scans: Sequence[RawScan]) -> RawScan:
    """Join scans that have one frame and one unit, all of them clouds or all of them meshes."""
    # A station without an answer says nothing of the normals and sensors of the others.
    scans = [scan for scan in scans if len(scan.points)] or scans[:1]
    if len(scans) == 1:
        return scans[0]
    starts = np.cumsum([0, *(len(scan.points) for scan in scans)])
    faces = [
        scan.faces + start
        for scan, start in zip(scans, starts, strict=False)
        if scan.faces is not None
    ]

    def of_all(name: str) -> NDArray[Any] | None:
        """The rows of all points, unless a scan has none."""
        found = [(getattr(scan, name), scan.points.shape) for scan in scans]
        if any(array is None for array, _ in found):
            return None
        return np.concatenate([np.broadcast_to(*one) for one in found])

    return RawScan(
        np.concatenate([scan.points for scan in scans]),
        np.concatenate(faces) if faces else None,
        of_all("normals"),
        of_all("viewpoints"),
        tuple(note for scan in scans for note in scan.notes),
        scans[0].unit,
    )


def axes_of(names: Sequence[str], pattern: re.Pattern[str]) -> tuple[int, ...] | None:
    """The numbers of the first three columns whose names are those of the axes, by a pattern."""
    axes = {
        found[1]: k
        for k, name in reversed([*enumerate(names)])
        if (found := pattern.fullmatch(name.lower()))
    }
    for three in ("xyz", "012"):
        if set(three) <= axes.keys():
            return tuple(axes[axis] for axis in three)
    return None


def scan_of_fields(
    names: Sequence[str], column: Callable[[str], NDArray[Any]]
) -> RawScan:
    """The scan in the named columns of a table, each of which a function gives as an (n,) array."""

    def table(pattern: re.Pattern[str]) -> NDArray[np.float64] | None:
        chosen = axes_of(names, pattern)
        if chosen is None:
            return None
        return np.stack([column(names[k]) for k in chosen], axis=1, dtype=np.float64)

    points = table(COORDINATE)
    if points is None:
        raise ScanReadError(
            f"a scan must have the fields {POINT_FIELDS}, this one has {' '.join(names)}"
        )
    return RawScan(points, None, table(NORMAL), table(SENSOR))


def fields_of(
    cloud: PointCloud, normals: str = NORMAL_FIELDS
) -> tuple[list[str], FloatArray]:
    """The names of the columns of a table, and the arrays of a cloud as one (n, c) table."""
    arrays = (
        (POINT_FIELDS, cloud.points),
        (normals, cloud.normals),
        (SENSOR_FIELDS, cloud.viewpoints),
    )
    given = [(names, array) for names, array in arrays if array is not None]
    table = np.concatenate([array for _, array in given], axis=1)
    return " ".join(names for names, _ in given).split(), table
