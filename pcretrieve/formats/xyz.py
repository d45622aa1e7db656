"""The text formats XYZ and XYZN: one point on each line, in XYZN with its normal."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from pcretrieve.errors import InputError
from pcretrieve.formats.format import Format
from pcretrieve.formats.raw import RawScan
from pcretrieve.formats.text import number_table, text_lines
from pcretrieve.types import PointCloud

__all__ = ["XYZ", "XYZN", "read_xyz", "read_xyzn"]

# Significant digits, sufficient for single precision.
DIGITS = 9


def read_xyz(path: Path) -> RawScan:
    """Read an XYZ file: ``x y z`` on each line; further columns are ignored.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    RawScan
        The points; unit of the file.

    Raises
    ------
    ScanReadError
        If the file is not a text file, or a line has too few numbers.
    """
    return RawScan(number_table(text_lines(path), n_columns=3))


def read_xyzn(path: Path) -> RawScan:
    """Read an XYZN file: ``x y z nx ny nz`` on each line.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    RawScan
        The points and their normals; unit of the file.

    Raises
    ------
    ScanReadError
        If the file is not a text file, or a line has too few numbers.
    """
    table = number_table(text_lines(path), n_columns=6)
    return RawScan(table[:, :3], normals=table[:, 3:])


def _xyzn_bytes(cloud: PointCloud) -> bytes:
    if cloud.normals is None:
        raise InputError(
            "an .xyzn file must hold normals, these points have none: write .ply, or estimate them"
        )
    text = io.BytesIO()
    np.savetxt(text, np.concatenate([cloud.points, cloud.normals], axis=1), fmt=f"%.{DIGITS}g")
    return text.getvalue()


XYZ = Format((".xyz",), read_xyz)
XYZN = Format((".xyzn",), read_xyzn, write_cloud=_xyzn_bytes)
