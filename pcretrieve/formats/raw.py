"""What a reader gives: the arrays of one file, before anything is checked."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import ScanReadError

__all__ = ["RawScan", "fans", "incomplete", "merged_vertices"]


class RawScan(NamedTuple):
    """Arrays of one file, in its own unit; coordinates may still be NaN.

    Attributes
    ----------
    points : (n, 3) float
    faces : (m, 3) int or None
        None for a point cloud.
    normals : (n, 3) float or None
    viewpoints : (n, 3) or (3,) float or None
        Sensor positions, in the frame of the points.
    notes : tuple of str
        What the reader had to work around.
    """

    points: NDArray[Any]
    faces: NDArray[Any] | None = None
    normals: NDArray[Any] | None = None
    viewpoints: NDArray[Any] | None = None
    notes: tuple[str, ...] = ()


def fans(polygons: Sequence[NDArray[Any]]) -> NDArray[np.int64]:
    """Polygons as fans of triangles.

    Parameters
    ----------
    polygons : sequence of (p, k) int
        Of k corners each; those of fewer than three vanish.

    Returns
    -------
    (m, 3) int64
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
    """Vertices that are at the same place made one, in lexicographic order; and the faces between them.

    Parameters
    ----------
    vertices : (n, 3) float
    faces : (m, 3) int
        Of these vertices.
    """
    vertices, inverse = np.unique(vertices, axis=0, return_inverse=True)
    return vertices, inverse.reshape(-1)[faces]


def incomplete(path: Path, reason: object) -> ScanReadError:
    """The error for a file that ends early, is damaged, or is of another format than its name says."""
    if isinstance(reason, UnicodeError):
        reason = "it holds bytes that are no text"  # instead of the words of a codec
    words = str(reason).splitlines() or [type(reason).__name__]
    return ScanReadError(
        f"not a complete {path.suffix[1:].upper()} file ({words[0]}): export or copy it again"
    )
