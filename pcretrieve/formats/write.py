"""Writing of point clouds, in formats that `read_scan` reads."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from pcretrieve.atomic import replace_file
from pcretrieve.conversion import CloudLike, as_cloud
from pcretrieve.errors import InputError
from pcretrieve.types import FloatArray

__all__ = ["SUFFIXES", "write_cloud"]

SUFFIXES = (".ply", ".pcd", ".xyzn")

# Significant digits in text files, sufficient for single precision.
DIGITS = 9

# The point types of PCL are of single precision, and its programs expect such files.
NUMBERS = {".ply": "<f8", ".pcd": "<f4"}
NAMES = {
    ".ply": ("x y z", "nx ny nz", "vp_x vp_y vp_z"),
    ".pcd": ("x y z", "normal_x normal_y normal_z", "vp_x vp_y vp_z"),
}


def write_cloud(cloud: CloudLike, path: str | Path) -> None:
    """Write points with their normals and the positions of their sensors, in one atomic step.

    Parameters
    ----------
    cloud : CloudLike
        The points; their unit is that of the file.
    path : str or Path
        The file. ``.ply`` (double precision) and ``.pcd`` (single precision) store the position of the sensor
        of each point in fields ``vp_x vp_y vp_z``, as PCL's PointWithViewpoint. ``.xyzn`` stores points and
        normals with nine digits. An existing file is replaced.

    Raises
    ------
    InputError
        If the suffix is not one of ``.ply .pcd .xyzn``, it is ``.xyzn`` and the points have no normals, or
        the file cannot be written.
    """
    cloud, path = as_cloud(cloud), Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"a point file must end in one of {' '.join(SUFFIXES)}, got {path.name}")
    if suffix == ".xyzn":
        if cloud.normals is None:
            raise InputError(f"an .xyzn file must hold normals, these points have none, got {path.name}")
        text = io.BytesIO()
        np.savetxt(text, np.concatenate([cloud.points, cloud.normals], axis=1), fmt=f"%.{DIGITS}g")
        data = text.getvalue()
    else:
        parts = (cloud.points, cloud.normals, cloud.viewpoints)
        held = [(names, part) for names, part in zip(NAMES[suffix], parts, strict=True) if part is not None]
        fields = " ".join(names for names, _ in held).split()
        header = _ply_header if suffix == ".ply" else _pcd_header
        table: FloatArray = np.concatenate([part for _, part in held], axis=1)  # (n, fields)
        data = header(fields, len(table)).encode() + table.astype(NUMBERS[suffix]).tobytes()
    try:
        replace_file(path, data)
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}") from error


def _ply_header(fields: list[str], n: int) -> str:
    properties = "".join(f"property double {field}\n" for field in fields)
    return f"ply\nformat binary_little_endian 1.0\nelement vertex {n}\n{properties}end_header\n"


def _pcd_header(fields: list[str], n: int) -> str:
    def repeated(word: str) -> str:
        return " ".join([word] * len(fields))

    return (
        "# .PCD v0.7 - Point Cloud Data file format\n"
        f"VERSION 0.7\nFIELDS {' '.join(fields)}\nSIZE {repeated('4')}\nTYPE {repeated('F')}\n"
        f"COUNT {repeated('1')}\nWIDTH {n}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA binary\n"
    )
