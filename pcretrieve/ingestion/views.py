"""Range scans that are to be merged: files → views, with the poses that a ``.conf`` file gives."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pcretrieve.conversion import as_cloud
from pcretrieve.errors import InputError, ScanReadError
from pcretrieve.formats import read_scan
from pcretrieve.formats.views import read_poses
from pcretrieve.ingestion.discover import discover
from pcretrieve.types import FloatArray, PointCloud

__all__ = ["Views", "read_views", "view_files"]


class Views(NamedTuple):
    """Range scans of one body.

    Attributes
    ----------
    files : tuple of Path
        One file for each view.
    clouds : tuple of PointCloud
        The points of each view in its own frame; of a mesh, its vertices.
    poses : (v, 4, 4) float64 or None
        Rigid motions of the views into a common frame, where the files give them.
    """

    files: tuple[Path, ...]
    clouds: tuple[PointCloud, ...]
    poses: FloatArray | None


def view_files(paths: Sequence[str | Path]) -> tuple[list[Path], FloatArray | None]:
    """The files that hold one view each, and their poses.

    Parameters
    ----------
    paths : sequence of str or Path
        Files, folders or globs, or one Stanford ``.conf`` file, which names the views and their poses.

    Returns
    -------
    files : list of Path
        In the order given.
    poses : (v, 4, 4) float64 or None
        Rigid motions into the common frame of the ``.conf`` file.

    Raises
    ------
    InputError
        If a path does not exist, or there are other files beside a ``.conf`` file.
    ScanReadError
        If the ``.conf`` file cannot be read.
    """
    files = discover(paths)
    confs = [file for file in files if file.suffix.lower() == ".conf"]
    if not confs:
        return files, None
    if len(files) > 1:
        raise InputError(f"a .conf names all views of its cloud, got {len(files)} files with {confs[0]}")
    try:
        views = read_poses(confs[0])
    except (ScanReadError, OSError) as error:
        cause = error.message if isinstance(error, ScanReadError) else error.strerror
        raise ScanReadError(f"{confs[0]}: {cause}") from error
    poses = np.tile(np.eye(4), (len(views), 1, 1))
    for pose, (_, rotation, translation) in zip(poses, views, strict=True):
        pose[:3, :3], pose[:3, 3] = rotation.as_matrix(), translation
    return [file for file, _, _ in views], poses


def read_views(paths: Sequence[str | Path]) -> Views:
    """Read the range scans that paths name.

    Parameters
    ----------
    paths : sequence of str or Path
        As in `view_files`.

    Returns
    -------
    Views
        In the unit of the files.

    Raises
    ------
    InputError
        As in `view_files`.
    ScanReadError
        If a file cannot be read.
    """
    files, poses = view_files(paths)
    return Views(tuple(files), tuple(as_cloud(read_scan(file)) for file in files), poses)
