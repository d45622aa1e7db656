"""Stanford ``.conf`` files, which name several range scans with their poses: they are merged to one cloud."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pcretrieve.errors import ScanReadError
from pcretrieve.formats.format import (
    Part,
    RawScan,
    check_file,
    joined,
    text_lines,
)
from pcretrieve.values import SENSOR_DISTANCE, FloatArray
from pcretrieve.values.files import MOST_MEMBERS, check_members

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

# The line of a view, with seven numbers after the name of the file.
LINE = "`bmesh FILE tx ty tz qx qy qz qw`"
# Largest size of a file that names views: a path has at most 4096 bytes.
MOST_CONF_BYTES = 4096 * MOST_MEMBERS


def read_poses(path: Path) -> list[tuple[Path, Rotation, FloatArray]]:
    """The file, the rotation R and the (3,) translation t of each view of a ``.conf`` file, in its unit.

    A point p of a view is at R p + t in the common frame. R is the inverse of the rotation of the quaternion
    in the file; with this convention the views of the Stanford scans are registered.
    """
    from scipy.spatial.transform import Rotation

    check_file(path)
    if path.stat().st_size > MOST_CONF_BYTES:
        raise ScanReadError(f"a .conf file must have at most {MOST_CONF_BYTES} bytes")
    named: dict[str, int] = {}
    poses = []
    for number, line in enumerate(text_lines(path), start=1):
        words = line.split()
        if not words or words[0] != "bmesh":
            continue
        try:
            pose = [float(word) for word in words[2:]]
            if len(pose) != 7 or not np.isfinite(pose).all():
                raise ValueError(f"got {' '.join(words[2:]) or 'none'}")
            rotation = Rotation.from_quat(pose[3:]).inv()
        except ValueError as error:
            raise ScanReadError(
                f"line {number} must read {LINE}, seven finite numbers: {error}"
            ) from error
        view = path.parent / words[1]
        # The real path, so that a view is found again under another name.
        earlier = named.setdefault(os.path.realpath(view), number)
        if earlier != number:
            raise ScanReadError(
                f"each view must be named once, lines {earlier} and {number} name {words[1]}"
            )
        check_members(len(named))
        poses.append((view, rotation, np.array(pose[:3])))
    if not poses:
        raise ScanReadError(f"a .conf file must name its views by lines {LINE}, got none")
    return poses


def read_conf(path: Path, read_view: Callable[[Path], RawScan]) -> RawScan:
    """Read the views of a ``.conf`` file, each by a function, in their common frame."""
    scans = [
        _moved(_view(path, view, read_view), rotation, translation)
        for view, rotation, translation in read_poses(path)
    ]
    # The notes of the views say nothing of the scan as a whole.
    return joined(scans)._replace(faces=None, notes=(), unit=None)


def conf_views(path: Path) -> tuple[Part, ...]:
    """The files of the views, with their poses."""
    parts = []
    for view, rotation, translation in read_poses(path):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation.as_matrix(), translation
        parts.append(Part(view, pose))
    return tuple(parts)


def _view(path: Path, view: Path, read_view: Callable[[Path], RawScan]) -> RawScan:
    """A view in its own frame, with a sensor far along the z axis if it has none: heights over a plane."""
    try:
        if view.suffix.lower() == path.suffix.lower():
            raise ScanReadError(
                "a view must be a single range scan, not a .conf file of its own"
            )
        scan = read_view(view)
        if not np.isfinite(scan.points).all(axis=1).any():
            raise ScanReadError("it has no points with finite coordinates")
    except ScanReadError as error:
        raise ScanReadError(f"its view {view.name}: {error.message}") from error
    if scan.viewpoints is not None:
        return scan
    low = np.nanmin(scan.points, axis=0)
    high = np.nanmax(scan.points, axis=0)
    distance = SENSOR_DISTANCE * float(np.linalg.norm(high - low))
    return scan._replace(viewpoints=(low + high) / 2 + np.array([0, 0, distance]))


def _moved(scan: RawScan, rotation: Rotation, translation: FloatArray) -> RawScan:
    # Copies, because scipy's rotations do not accept read-only arrays.
    sensors = np.array(np.broadcast_to(scan.viewpoints, scan.points.shape))  # type: ignore[arg-type]
    return RawScan(
        rotation.apply(scan.points) + translation,
        None,
        None if scan.normals is None else rotation.apply(scan.normals),
        rotation.apply(sensors) + translation,
    )
