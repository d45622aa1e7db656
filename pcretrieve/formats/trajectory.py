"""The trajectory of a depth camera: the poses of its images in the layout of the TUM RGB-D benchmark [1]_.

The folder of the images, ``depth``, lies beside the list ``depth.txt`` of times and images, and beside the
poses in ``groundtruth.txt``: a time, a translation and a quaternion in each line, ``t tx ty tz qx qy qz qw``.
The benchmark's tool ``associate.py`` joins lines of both in ``associations.txt``.

References
----------
.. [1] J. Sturm, N. Engelhard, F. Endres, W. Burgard and D. Cremers, "A benchmark for the evaluation of RGB-D
   SLAM systems", IROS 2012.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from pcretrieve.arrays import FloatArray
from pcretrieve.errors import ScanReadError
from pcretrieve.formats.files import check_file
from pcretrieve.formats.text import text_lines

__all__ = ["MOST_SECONDS", "image_poses", "trajectory_file"]

# Files of a folder with poses, the first of which is read, and lists of images with their times.
TRAJECTORIES = ("groundtruth.txt", "associations.txt")
LISTS = ("depth.txt", "associations.txt")

# Numbers of a pose: a time, a translation and a quaternion.
N_NUMBERS = 8

# Largest time between an image and its pose, as in associate.py; s.
MOST_SECONDS = 0.02


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
    return next((file for file in files if file.is_file() and any(map(_has_pose, _lines(file)))), None)


def image_poses(images: Sequence[Path], file: Path) -> list[FloatArray | None]:
    """The poses of images, from the frame of the camera to a common frame.

    Returns list of ((4, 4) float64 or None): the pose at the nearest time, for each image; m. None if that is
        more than `MOST_SECONDS` away, or the time of the image is not known.
    """
    from scipy.spatial.transform import Rotation

    numbers = np.array(
        [_numbers(line[-N_NUMBERS:], file) for line in _lines(file) if _has_pose(line)]
    )  # (k, 8)
    lengths = np.linalg.norm(numbers[:, 4:], axis=1)
    if not (np.isfinite(numbers).all() and lengths.all()):
        raise ScanReadError(f"the poses in {file.name} must be finite, with quaternions that are not zero")
    poses = np.tile(np.eye(4), (len(numbers), 1, 1))
    poses[:, :3, :3] = Rotation.from_quat(numbers[:, 4:]).as_matrix()
    poses[:, :3, 3] = numbers[:, 1:4]
    times = _times(file.parent)
    found: list[FloatArray | None] = []
    for image in images:
        time = times.get(image.absolute(), _number(image.stem))
        nearest = int(abs(numbers[:, 0] - time).argmin()) if np.isfinite(time) else 0
        found.append(poses[nearest] if abs(numbers[nearest, 0] - time) <= MOST_SECONDS else None)
    return found


def _times(folder: Path) -> dict[Path, float]:
    """The times of images: of the words ``time name`` in the lines of the lists of a folder."""
    times = {}
    for name in LISTS:
        if (folder / name).is_file():
            for line in _lines(folder / name):
                for time, image in pairwise(line):
                    if not np.isfinite(_number(image)):
                        times[folder / image] = _number(time)
    return times


def _lines(file: Path) -> list[list[str]]:
    """The words of the lines of a text file that are not comments."""
    check_file(file)
    lines = (line.replace(",", " ").split() for line in text_lines(file))
    return [words for words in lines if words and not words[0].startswith("#")]


def _has_pose(words: Sequence[str]) -> bool:
    """Whether a line has a pose, alone or after the time and the name of an image."""
    return len(words) in (N_NUMBERS, N_NUMBERS + 2)


def _numbers(words: Sequence[str], file: Path) -> list[float]:
    try:
        return [float(word) for word in words]
    except ValueError as error:
        raise ScanReadError(
            f"a line of {file.name} must end in `t tx ty tz qx qy qz qw`, eight numbers: {' '.join(words)}"
        ) from error


def _number(word: str) -> float:
    """The number of a word; NaN if it is none."""
    try:
        return float(word)
    except ValueError:
        return float("nan")
