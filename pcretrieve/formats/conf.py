"""Stanford ``.conf`` files: several range scans with given poses → one cloud."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pcretrieve.errors import ScanReadError
from pcretrieve.formats.files import check_file
from pcretrieve.formats.format import Format, Part
from pcretrieve.formats.raw import RawScan
from pcretrieve.formats.text import text_lines

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

__all__ = ["SENSOR_DISTANCE", "conf_format", "read_poses"]

# Numbers after the file name on a line `bmesh FILE tx ty tz qx qy qz qw`.
N_POSE_NUMBERS = 7

# Largest number of views: about half a minute of a sensor with thirty frames a second.
MOST_VIEWS = 1000
# Largest size of a file: a path has at most 4096 bytes, and a line usually 100.
MOST_CONF_BYTES = MOST_VIEWS * 4096

# Distance of the conventional sensor of range scanners, in diagonals of the view:
# its rays are nearly parallel.
SENSOR_DISTANCE = 10.0


def read_poses(path: Path) -> list[tuple[Path, Rotation, np.ndarray]]:
    """Read the poses of the views of a Stanford ``.conf`` file.

    A point p of a view is at R p + t in the common frame. R is the inverse of the rotation of the quaternion
    in the file; with this convention the views of the Stanford scans are registered.

    Returns list of (Path, Rotation, (3,) float64): file, rotation R and translation t of each view, at most
        `MOST_VIEWS`; unit of the views.
    """
    from scipy.spatial.transform import Rotation

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
        # The real path, so that a view is found again under another name.
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


def conf_format(read_view: Callable[[Path], RawScan]) -> Format:
    """The format of Stanford ``.conf`` files."""
    return Format((".conf",), lambda path: _read_conf(path, read_view), _views)


def _views(path: Path) -> tuple[Part, ...]:
    parts = []
    for view, rotation, translation in read_poses(path):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation.as_matrix(), translation
        parts.append(Part(view, pose))
    return tuple(parts)


def _read_conf(path: Path, read_view: Callable[[Path], RawScan]) -> RawScan:
    scans = []
    for view, rotation, translation in read_poses(path):
        try:
            if view.suffix.lower() == path.suffix.lower():
                raise ScanReadError("a view must be a single range scan, not a .conf file of its own")
            scan = read_view(view)
            if not np.isfinite(scan.points).all(axis=1).any():
                raise ScanReadError("it has no points with finite coordinates")
        except ScanReadError as error:
            raise ScanReadError(f"its view {view.name}: {error.message}") from error
        scans.append((seen_from_front(scan), rotation, translation))
    return merge(scans)


def seen_from_front(scan: RawScan) -> RawScan:
    """Add the conventional sensor of range scanners to a view without sensor positions.

    Range scanners, such as those of the Stanford repository, write heights over a plane: the sensor looks in
    the direction −z. It is placed far along the z axis. See docs/decisions.md, seen_from_front.
    """
    if scan.viewpoints is not None or not len(scan.points):
        return scan
    low, high = np.nanmin(scan.points, axis=0), np.nanmax(scan.points, axis=0)
    distance = SENSOR_DISTANCE * float(np.linalg.norm(high - low))
    return scan._replace(viewpoints=(low + high) / 2 + np.array([0, 0, distance]))


def merge(views: list[tuple[RawScan, Rotation, np.ndarray]]) -> RawScan:
    """Merge views with given poses.

    views: list of (RawScan, Rotation, (3,) float64), the views, with rotation and translation of each into
        the common frame.
    """
    points, normals, viewpoints = [], [], []
    for scan, rotation, translation in views:
        points.append(rotation.apply(scan.points) + translation)
        if scan.normals is not None:
            normals.append(rotation.apply(scan.normals))
        if scan.viewpoints is not None:
            # A copy, because scipy's rotations do not accept read-only arrays.
            sensors = np.array(np.broadcast_to(scan.viewpoints, scan.points.shape))
            viewpoints.append(rotation.apply(sensors) + translation)
    return RawScan(
        np.concatenate(points),
        None,
        np.concatenate(normals) if len(normals) == len(views) else None,
        np.concatenate(viewpoints) if len(viewpoints) == len(views) else None,
    )
