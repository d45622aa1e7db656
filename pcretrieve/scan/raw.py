"""What a reader gives: the arrays of one file, before anything is checked."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import ScanReadError

__all__ = ["RawScan", "incomplete", "triangles"]


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


def triangles(polygons: Sequence[Sequence[int]] | NDArray[np.object_]) -> NDArray[np.int64]:
    """Polygons as fans of triangles, (m, 3); those of fewer than three corners vanish."""
    by_size: dict[int, list[Sequence[int]]] = {}
    for polygon in polygons:
        by_size.setdefault(len(polygon), []).append(polygon)
    fans = []
    for size, group in by_size.items():
        corners = np.array(group, dtype=np.int64)  # (p, size)
        fans += [corners[:, [0, k, k + 1]] for k in range(1, size - 1)]
    return np.concatenate(fans) if fans else np.empty((0, 3), dtype=np.int64)


def incomplete(path: Path, reason: object) -> ScanReadError:
    """The error for a file that ends early, is damaged, or is of another format than its name says."""
    words = str(reason).splitlines() or [type(reason).__name__]
    return ScanReadError(
        f"not a complete {path.suffix[1:].upper()} file ({words[0]}): export or copy it again"
    )
