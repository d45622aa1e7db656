"""Files of range scans → views, with the poses in a ``.conf`` file or in a trajectory → one cloud.

A trajectory has the layout of the TUM RGB-D benchmark [1]_: the folder of the images, ``depth``, lies beside
the list ``depth.txt`` of times and images, and beside the poses in ``groundtruth.txt``: a time, a translation
and a quaternion in each line, ``t tx ty tz qx qy qz qw``. The benchmark's tool ``associate.py`` joins lines
of both in ``associations.txt``.

References
----------
.. [1] J. Sturm, N. Engelhard, F. Endres, W. Burgard and D. Cremers, "A benchmark for the evaluation of RGB-D
   SLAM systems", IROS 2012.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pcretrieve.errors import InputError, ScanReadError
from pcretrieve.formats import (
    ScanLike,
    ScanPath,
    as_scan,
    parts_of,
    write_cloud,
)
from pcretrieve.formats.files import check_output
from pcretrieve.formats.format import check_file, text_lines
from pcretrieve.formats.identity import printable
from pcretrieve.ingestion.discover import discover
from pcretrieve.ingestion.pool import alone
from pcretrieve.options import MergeOptions, OptionsLike, PipelineOptions
from pcretrieve.pipeline.registration import Merged, merge_views as merge_clouds
from pcretrieve.values import FloatArray, PointCloud
from pcretrieve.values.conversion import as_cloud

logger = logging.getLogger(__name__)

# Files of a folder with poses, the first of which is read, and lists of images with their times.
TRAJECTORIES = ("groundtruth.txt", "associations.txt")
LISTS = ("depth.txt", "associations.txt")
# Numbers of a pose of a trajectory: a time, a translation and a quaternion.
N_NUMBERS = 8
# Largest time between an image and its pose, as in associate.py; s.
MOST_SECONDS = 0.02


class Views(NamedTuple):
    """Range scans of one body; poses as `view_files` gives them."""

    clouds: list[PointCloud]
    poses: FloatArray | None


def merge_views(
    views: str | Path | Sequence[ScanLike],
    options: MergeOptions | OptionsLike = None,
    *,
    output: str | Path | None = None,
    timeout: float | None = None,
    memory: float | None = None,
) -> Merged:
    """Register range scans of one body, and merge them into one cloud.

    Parameters
    ----------
    views : str, Path, or a sequence of ScanLike
        A folder, a glob or a Stanford ``.conf`` file; or the views, each a file, an array or geometry.
    options : MergeOptions or OptionsLike, optional
        The parameters of the registration, or options that have them in the table ``[merge]``, and
        ``max_range`` in the table ``[scan]``. By default the defaults.
    output : str or Path, optional
        A file to which the cloud is written.
    timeout : float, optional
        Longest time for each view; seconds. Files are then merged in another process, not in this one.
    memory : float, optional
        Largest heap of that process; GiB.

    Returns
    -------
    Merged
        The merged cloud, the poses, and the overlaps and residuals of the views.

    Raises
    ------
    InputError
        If there are fewer than two views, or the output cannot be written.
    OptionError
        If an option does not exist, or its value is not allowed.
    ReconstructionError
        If no two views share a surface.
    """
    chosen = PipelineOptions.of(
        {"merge": options} if isinstance(options, MergeOptions) else options
    )
    named = [views] if isinstance(views, (str, Path)) else views
    paths = [view for view in named if isinstance(view, (str, Path))]
    limits = None if timeout is None else {"timeout": timeout, "memory": memory}
    files = view_files(paths, limits)[0] if len(paths) == len(named) else []
    if output is not None:
        check_output(Path(output), [scan.file for scan in files], "point")
    if not files:
        merged = merge_clouds(
            [as_cloud(as_scan(view)) for view in named], chosen.merge, chosen.scan
        )
    elif timeout is None:
        merged = _merged(paths, chosen)
    else:
        merged = alone(
            _merged, paths, chosen, timeout=timeout * len(files), memory=memory
        )
    if output is not None:
        write_cloud(merged.cloud, output)
    return replace(merged, names=tuple(map(printable, files)))


def _merged(paths: Sequence[str | Path], options: PipelineOptions) -> Merged:
    read = read_views(paths)
    return merge_clouds(read.clouds, options.merge, options.scan, poses=read.poses)


def view_files(
    paths: Sequence[str | Path], limits: Mapping[str, float | None] | None = None
) -> tuple[list[ScanPath], FloatArray | None]:
    """Find the files of views, as `discover` does, and their poses.

    Returns poses : (v, 4, 4) float64 or None: rigid motions of the views into a common frame, if the files,
        or a trajectory beside them, give those of all views.
    """
    scans = discover(paths, limits=limits)
    for scan in scans:
        try:
            views = [view for view in parts_of(scan.file) if view.pose is not None]
        except (ScanReadError, OSError) as error:
            cause = error.message if isinstance(error, ScanReadError) else error.strerror
            raise ScanReadError(f"{scan}: {cause}") from error
        if views and len(scans) > 1:
            raise InputError(
                f"a {scan.file.suffix} names all views of its cloud, got {len(scans)} files with {scan}"
            )
        if views:
            named = [ScanPath.parse(view.path) for view in views]
            return named, np.array([view.pose for view in views])
    images = [scan.file for scan in scans]
    trajectory = trajectory_file(images)
    if trajectory is None:
        return scans, None
    poses = [pose for pose in image_poses(images, trajectory) if pose is not None]
    if len(poses) < len(images):
        words = "%s has no pose at the time of %d of %d images: all poses are searched"
        logger.warning(words, trajectory, len(images) - len(poses), len(images))
        return scans, None
    return scans, np.array(poses)


def read_views(paths: Sequence[str | Path]) -> Views:
    """Read range scans, in the unit of the files, and their poses.

    Scans of one file are in its common frame, unless all sensors are at one place, as without poses.
    """
    files, poses = view_files(paths)
    clouds = [as_cloud(as_scan(file)) for file in files]
    if poses is None and len(clouds) > 1 and len({file.whole for file in files}) == 1:
        sensors = {
            tuple(cloud.viewpoints[0]) for cloud in clouds if cloud.viewpoints is not None
        }
        poses = None if len(sensors) == 1 else np.tile(np.eye(4), (len(clouds), 1, 1))
    return Views(clouds, poses)


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
