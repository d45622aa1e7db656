"""Views with given poses: Stanford ``.conf`` files of range scans, and trajectories of depth cameras.

A ``.conf`` file names several range scans, which are merged to one cloud. A trajectory has the layout of the
TUM RGB-D benchmark [1]_: the folder of the images, ``depth``, lies beside the list ``depth.txt`` of times and
images, and beside the poses in ``groundtruth.txt``: a time, a translation and a quaternion in each line,
``t tx ty tz qx qy qz qw``. The benchmark's tool ``associate.py`` joins lines of both in ``associations.txt``.

References
----------
.. [1] J. Sturm, N. Engelhard, F. Endres, W. Burgard and D. Cremers, "A benchmark for the evaluation of RGB-D
   SLAM systems", IROS 2012.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from itertools import pairwise
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
from pcretrieve.values import FloatArray
from pcretrieve.values.files import MOST_MEMBERS, check_members
from pcretrieve.values.geometry import SENSOR_DISTANCE

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

# The line of a view, with seven numbers after the name of the file.
LINE = "`bmesh FILE tx ty tz qx qy qz qw`"
# Largest size of a file that names views: a path has at most 4096 bytes.
MOST_CONF_BYTES = 4096 * MOST_MEMBERS

# Files of a folder with poses, the first of which is read, and lists of images with their times.
TRAJECTORIES = ("groundtruth.txt", "associations.txt")
LISTS = ("depth.txt", "associations.txt")
# Numbers of a pose of a trajectory: a time, a translation and a quaternion.
N_NUMBERS = 8
# Largest time between an image and its pose, as in associate.py; s.
MOST_SECONDS = 0.02


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
    low, high = np.nanmin(scan.points, axis=0), np.nanmax(scan.points, axis=0)
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


# --- trajectories -----------------------------------------------------------------------------------------


def trajectory_file(images: Sequence[Path]) -> Path | None:
    """The file with the poses of images."""
    folders = {image.absolute().parent for image in images}
    if len(folders) != 1:
        return None
    (folder,) = folders
    if folder.name != "depth":
        return None
    files = [folder.parent / name for name in TRAJECTORIES]
    # Associations of colour with depth images, of four words, have no poses.
    return next(
        (file for file in files if file.is_file() and any(map(_has_pose, _lines(file)))),
        None,
    )


def image_poses(images: Sequence[Path], file: Path) -> list[FloatArray | None]:
    """The (4, 4) pose of each image at the nearest time, from the frame of the camera to a common frame; m.

    None if that is more than `MOST_SECONDS` away, or the time of the image is not known.
    """
    from scipy.spatial.transform import Rotation

    lines = [line[-N_NUMBERS:] for line in _lines(file) if _has_pose(line)]
    numbers = np.array([[_number(word) for word in line] for line in lines])  # (k, 8)
    if not (np.isfinite(numbers).all() and numbers[:, 4:].any(axis=1).all()):
        raise ScanReadError(
            f"the lines of {file.name} must end in `t tx ty tz qx qy qz qw`, eight finite numbers with a "
            "quaternion that is not zero"
        )
    poses = np.tile(np.eye(4), (len(numbers), 1, 1))
    poses[:, :3, :3] = Rotation.from_quat(numbers[:, 4:]).as_matrix()
    poses[:, :3, 3] = numbers[:, 1:4]
    times = _times(file.parent)
    found: list[FloatArray | None] = []
    for image in images:
        time = times.get(image.absolute(), _number(image.stem))
        nearest = int(abs(numbers[:, 0] - time).argmin()) if np.isfinite(time) else 0
        found.append(
            poses[nearest] if abs(numbers[nearest, 0] - time) <= MOST_SECONDS else None
        )
    return found


def _times(folder: Path) -> dict[Path, float]:
    """The times of images: of the words ``time name`` in the lines of the lists of a folder."""
    return {
        folder / image: _number(time)
        for name in LISTS
        if (folder / name).is_file()
        for line in _lines(folder / name)
        for time, image in pairwise(line)
        if not np.isfinite(_number(image))
    }


def _lines(file: Path) -> list[list[str]]:
    """The words of the lines of a text file that are not comments."""
    check_file(file)
    lines = (line.replace(",", " ").split() for line in text_lines(file))
    return [words for words in lines if words and not words[0].startswith("#")]


def _has_pose(words: Sequence[str]) -> bool:
    """Whether a line has a pose, alone or after the time and the name of an image."""
    return len(words) in (N_NUMBERS, N_NUMBERS + 2)


def _number(word: str) -> float:
    """The number of a word; NaN if it is none."""
    try:
        return float(word)
    except ValueError:
        return float("nan")
