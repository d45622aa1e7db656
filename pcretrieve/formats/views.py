"""Several range scans and their poses → one cloud."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from pcretrieve.errors import ScanReadError
from pcretrieve.formats.files import check_file
from pcretrieve.formats.raw import RawScan
from pcretrieve.formats.text import text_lines

__all__ = ["read_poses", "view_paths"]

# bmesh FILE tx ty tz qx qy qz qw
N_POSE_NUMBERS = 7

# A sensor that goes round a body for half a minute at thirty frames a second takes 900 views.
MOST_VIEWS = 1000
# One line is about 100 bytes; the path of a view may be 4096 bytes long.
MOST_CONF_BYTES = MOST_VIEWS * 4096

# Far enough that its rays are all but parallel; in diagonals of the view.
SENSOR_DISTANCE = 10.0


def read_poses(path: Path) -> list[tuple[Path, Rotation, np.ndarray]]:
    """File, rotation and translation of each view of a Stanford ``.conf`` file.

    A point p of a view lies at R p + t in the common frame. R is the inverse of the quaternion that the
    file gives: with it the views of the Stanford scans meet, with the quaternion itself they do not.

    Parameters
    ----------
    path : Path

    Returns
    -------
    list of (Path, Rotation, (3,) float64)
        Each view once, `MOST_VIEWS` at most; translations in the unit of the views.

    Raises
    ------
    OSError
        If there is no such file.
    ScanReadError
        If it is not a regular file, not such a text, names no views, too many, or one of them twice.
    """
    check_file(path)
    if path.stat().st_size > MOST_CONF_BYTES:
        raise ScanReadError(
            f"a .conf file must have at most {MOST_CONF_BYTES} bytes, got {path.stat().st_size}"
        )
    lines = text_lines(path)
    named: dict[str, int] = {}
    poses = []
    for number, line in enumerate(lines, start=1):
        words = line.split()
        if not words or words[0] != "bmesh":
            continue
        try:
            pose = [float(word) for word in words[2:]]
            if len(pose) != N_POSE_NUMBERS or not np.isfinite(pose).all():
                raise ValueError(f"got {' '.join(words[2:]) or 'none'}")
            rotation = Rotation.from_quat(pose[3:]).inv()
        except ValueError as error:
            raise ScanReadError(
                f"line {number} must read `bmesh FILE tx ty tz qx qy qz qw`, seven finite numbers: {error}"
            ) from error
        view = path.parent / words[1]
        # The real path, so that a view cannot be named again through links.
        earlier = named.setdefault(os.path.realpath(view), number)
        if earlier != number:
            raise ScanReadError(f"each view must be named once, lines {earlier} and {number} name {words[1]}")
        if len(named) > MOST_VIEWS:
            raise ScanReadError(
                f"a .conf file must name at most {MOST_VIEWS} views: merge parts of the scan first"
            )
        poses.append((view, rotation, np.array(pose[:3])))
    if not poses:
        raise ScanReadError(
            "a .conf file must name its views by lines `bmesh FILE tx ty tz qx qy qz qw`, got none"
        )
    return poses


def view_paths(path: Path) -> list[Path]:
    """The files that a ``.conf`` file merges.

    Raises
    ------
    OSError, ScanReadError
        As `read_poses` does.
    """
    return [view for view, _, _ in read_poses(path)]


def seen_from_front(scan: RawScan) -> RawScan:
    """The view with a sensor far out on the z axis of its own frame, where the file names none.

    Range scanners write a height over the plane that they look at along −z; so do those of the Stanford
    repository. With it the dragon's Poisson surface has Euler characteristic 0, with a flood of the
    outside −204.
    """
    if scan.viewpoints is not None or not len(scan.points):
        return scan
    low, high = np.nanmin(scan.points, axis=0), np.nanmax(scan.points, axis=0)
    distance = SENSOR_DISTANCE * float(np.linalg.norm(high - low))
    return scan._replace(viewpoints=(low + high) / 2 + np.array([0, 0, distance]))


def merge(views: list[tuple[RawScan, Rotation, np.ndarray]]) -> RawScan:
    """The views in their common frame.

    Normals and sensor positions survive where every view has them.
    """
    points, normals, viewpoints = [], [], []
    for scan, rotation, translation in views:
        points.append(rotation.apply(scan.points) + translation)
        if scan.normals is not None:
            normals.append(rotation.apply(scan.normals))
        if scan.viewpoints is not None:
            # A copy: scipy's rotations refuse read-only views.
            sensors = np.array(np.broadcast_to(scan.viewpoints, scan.points.shape))
            viewpoints.append(rotation.apply(sensors) + translation)
    return RawScan(
        np.concatenate(points),
        None,
        np.concatenate(normals) if len(normals) == len(views) else None,
        np.concatenate(viewpoints) if len(viewpoints) == len(views) else None,
    )
