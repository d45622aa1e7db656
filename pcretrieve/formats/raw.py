"""The result of a reader: the arrays of one file, before they are checked."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import ScanReadError

__all__ = ["RawScan", "fans", "incomplete", "merged_vertices"]


class RawScan(NamedTuple):
    """The arrays of one file, in its unit.

    Attributes
    ----------
    points : (n, 3) float
        Coordinates, which may be NaN or infinite.
    faces : (m, 3) int or None
        Vertex numbers of triangles; None for a point cloud.
    normals : (n, 3) float or None
        Normals, of any length.
    viewpoints : (n, 3) or (3,) float or None
        Positions of the sensors of all points, or of one sensor, in the frame of the points.
    notes : tuple of str
        Notes of the reader for the provenance.
    """

    points: NDArray[Any]
    faces: NDArray[Any] | None = None
    normals: NDArray[Any] | None = None
    viewpoints: NDArray[Any] | None = None
    notes: tuple[str, ...] = ()


def fans(polygons: Sequence[NDArray[Any]]) -> NDArray[np.int64]:
    """Triangulate polygons as fans around their first corners.

    Parameters
    ----------
    polygons : sequence of (p, k) int
        Vertex numbers of polygons of k corners; polygons of fewer than three corners are ignored.

    Returns
    -------
    (m, 3) int64
        Vertex numbers of the triangles.
    """
    triangles = [
        corners if corners.shape[1] == 3 else corners[:, [0, k, k + 1]]
        for corners in polygons
        for k in range(1, corners.shape[1] - 1)
    ]
    if not triangles:
        return np.empty((0, 3), dtype=np.int64)
    return np.concatenate(triangles, dtype=np.int64, casting="unsafe")


def merged_vertices(
    vertices: NDArray[Any], faces: NDArray[np.integer[Any]]
) -> tuple[NDArray[Any], NDArray[np.integer[Any]]]:
    """Merge vertices with equal coordinates.

    Parameters
    ----------
    vertices : (n, 3) float
        Coordinates.
    faces : (m, 3) int
        Vertex numbers of each face.

    Returns
    -------
    vertices : (p, 3) float
        Distinct coordinates, in lexicographic order.
    faces : (m, 3) int
        Numbers of the merged vertices of each face.
    """
    vertices, inverse = np.unique(vertices, axis=0, return_inverse=True)
    return vertices, inverse.reshape(-1)[faces]


def incomplete(path: Path, reason: object) -> ScanReadError:
    """The error for a file that is truncated, damaged, or not of the format of its suffix.

    Parameters
    ----------
    path : Path
        The file.
    reason : object
        An exception or a text, of which the first line is used.

    Returns
    -------
    ScanReadError
        The error to be raised.
    """
    if isinstance(reason, UnicodeError):
        reason = "it holds bytes that are no text"  # instead of the message of the codec
    words = str(reason).splitlines() or [type(reason).__name__]
    return ScanReadError(
        f"not a complete {path.suffix[1:].upper()} file ({words[0]}): export or copy it again"
    )
