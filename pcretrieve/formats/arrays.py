"""Points in NumPy's files: an array in ``.npy``, arrays by name in ``.npz``.

Arrays of Python objects are not read, because unpickling runs code.
"""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import ScanReadError
from pcretrieve.formats.depth import camera_parts, depth_scan
from pcretrieve.formats.format import (
    COORDINATE,
    Part,
    RawScan,
    are_normals,
    axes_of,
    checked,
    scan_of_fields,
    without_zeros,
)
from pcretrieve.formats.text import FEWEST_POINTS, MOST_COLUMNS
from pcretrieve.values.base import numbers
from pcretrieve.values.files import array_header, member_array, opened_archive, read_array

# Names of arrays in .npz files, the first of which is taken.
POINTS = (
    "points",
    "xyz",
    "vertices",
    "pos",
    "positions",
    "coords",
    "coordinates",
    "pc",
    "v",
)
FACES = ("faces", "triangles", "f")
NORMALS = ("normals", "normal", "n")
VIEWPOINTS = ("viewpoints", "viewpoint", "sensors", "sensor")


def read_npy(path: Path) -> RawScan:
    """Read a NumPy array of points (n, c) or (h, w, c), of records, or of depths; rows of zeros are dropped.

    Columns four to six are normals if all have unit length. An array (h, w) of more than `MOST_COLUMNS` is a
    depth image, if the file of its camera lies beside it: see `depth_scan`.
    """
    with path.open("rb") as file:
        array = read_array(file, path.stat().st_size)
    if _is_image(array.shape, array.dtype) and camera_parts(path):
        return depth_scan(path, array)
    return without_zeros(_scan_of(array))


def read_npz(path: Path) -> RawScan:
    """Read the points or the mesh of a NumPy archive; rows of zeros of a cloud are dropped with a note."""
    with opened_archive(path) as archive:
        members = _members(archive)

        def array(known: tuple[str, ...]) -> NDArray[Any] | None:
            """The first array of these names."""
            for name in known:
                if name in members:
                    return member_array(archive, members[name])
            return None

        found = array(POINTS if len(members) != 1 else tuple(members))
        if found is None:
            raise ScanReadError(
                f"it must hold an array 'points', got {', '.join(members) or 'no arrays'}"
            )
        faces, normals, viewpoints = array(FACES), array(NORMALS), array(VIEWPOINTS)
    scan = _scan_of(found)
    if normals is None:
        normals = scan.normals
    scan = checked(scan._replace(faces=faces, normals=normals, viewpoints=viewpoints))
    return scan if faces is not None else without_zeros(scan)


def recognise_npy(path: Path) -> bool:
    """Whether the array has the shape of a table of points."""
    shape, dtype = _declared(path)
    if _is_image(shape, dtype):
        return bool(camera_parts(path))
    if dtype.names:
        return axes_of(dtype.names, COORDINATE) is not None
    return (
        dtype.kind in "fiu"
        and len(shape) in (2, 3)
        and 3 <= shape[-1] <= MOST_COLUMNS
        and int(np.prod(shape[:-1], dtype=float)) >= FEWEST_POINTS
    )


def parts_of_npy(path: Path) -> tuple[Part, ...]:
    """The file of the camera, of a depth image."""
    return camera_parts(path) if _is_image(*_declared(path)) else ()


def _declared(path: Path) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """The shape and the type of the array in a file."""
    with path.open("rb") as file:
        return array_header(file)[:2]


def _is_image(shape: tuple[int, ...], dtype: np.dtype[Any]) -> bool:
    """Whether an array may be a depth image, because it has too many columns for a table of points."""
    return len(shape) == 2 and shape[1] > MOST_COLUMNS and dtype.kind in "fiu"


def recognise_npz(path: Path) -> bool:
    """Whether an archive has an array of points."""
    with opened_archive(path) as archive:
        return not {*POINTS}.isdisjoint(_members(archive))


def _scan_of(array: NDArray[Any]) -> RawScan:
    """The points, and the normals, of an array of numbers or of records."""
    if array.dtype.names:
        return scan_of_fields(
            array.dtype.names, lambda name: numbers(name, array[name]).ravel()
        )
    if array.ndim not in (2, 3) or not 3 <= array.shape[-1] <= MOST_COLUMNS:
        raise ScanReadError(
            f"an array of points must have the shape (n, c) or (h, w, c), c from 3 to {MOST_COLUMNS}, "
            f"got {array.shape}"
        )
    table = numbers("coordinates", array).reshape(-1, array.shape[-1]).astype(np.float64)
    keep = table.shape[1] >= 6 and are_normals(table[:, 3:6])
    return RawScan(table[:, :3], normals=table[:, 3:6] if keep else None)


def _members(archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    """The arrays of an archive by name, in lower case."""
    arrays = (info for info in archive.infolist() if info.filename.endswith(".npy"))
    return {info.filename.removesuffix(".npy").lower(): info for info in arrays}
