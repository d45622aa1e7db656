"""The result of a reader: the arrays of one file, before they are checked."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import ScanReadError

__all__ = ["RawScan", "are_normals", "fans", "incomplete", "joined", "merged_vertices", "without_zeros"]

# Tolerance of the length of normals that a file does not name: they may have three digits.
UNIT_TOLERANCE = 1e-2


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
    unit : str or None
        The unit of length of the file, a key of `METRES`; None if the file does not say.
    """

    points: NDArray[Any]
    faces: NDArray[Any] | None = None
    normals: NDArray[Any] | None = None
    viewpoints: NDArray[Any] | None = None
    notes: tuple[str, ...] = ()
    unit: str | None = None


def fans(polygons: Sequence[NDArray[Any]]) -> NDArray[np.int64]:
    """Triangulate polygons as fans around their first corners.

    polygons: sequence of (p, k) int, vertex numbers of polygons of k corners; polygons of fewer than three
        corners are ignored.
    Returns (m, 3) int64: vertex numbers of the triangles.
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

    vertices: (n, 3) float, coordinates.
    faces: (m, 3) int, vertex numbers of each face.
    Returns vertices : (p, 3) float: distinct coordinates, in lexicographic order.
    Returns faces : (m, 3) int: numbers of the merged vertices of each face.
    """
    vertices, inverse = np.unique(vertices, axis=0, return_inverse=True)
    return vertices, inverse.reshape(-1)[faces]


def are_normals(vectors: NDArray[Any]) -> bool:
    """Whether vectors are unit normals, and not colours.

    vectors: (n, 3) float, columns of a table that does not name them.
    Returns bool: whether all finite ones have unit length, and some have negative components, unlike colours.
    """
    vectors = vectors[np.isfinite(vectors).all(axis=1)]
    return bool(
        len(vectors)
        and (vectors < 0).any()
        and (np.abs(np.linalg.norm(vectors, axis=1) - 1) < UNIT_TOLERANCE).all()
    )


def without_zeros(scan: RawScan) -> RawScan:
    """Drop the readings that a sensor without an answer has written as zeros."""
    missing = (scan.points == 0).all(axis=1)  # (n,)
    n_missing = int(missing.sum())
    if n_missing < 2 or n_missing == len(missing):
        return scan
    viewpoints = scan.viewpoints
    return RawScan(
        scan.points[~missing],
        None,
        None if scan.normals is None else scan.normals[~missing],
        viewpoints if viewpoints is None or viewpoints.ndim == 1 else viewpoints[~missing],
        (
            *scan.notes,
            f"dropped {n_missing} of {len(missing)} points at zero: readings without an answer",
        ),
    )


def joined(scans: Sequence[RawScan]) -> RawScan:
    """Join scans that have one frame.

    scans: at least one, in one unit; all are clouds, or all are meshes.
    """
    if len(scans) == 1:
        return scans[0]
    starts = np.cumsum([0, *(len(scan.points) for scan in scans)])
    faces = [scan.faces + start for scan, start in zip(scans, starts, strict=False) if scan.faces is not None]
    normals = [scan.normals for scan in scans if scan.normals is not None]
    sensors = [
        np.broadcast_to(scan.viewpoints, scan.points.shape) for scan in scans if scan.viewpoints is not None
    ]
    return RawScan(
        np.concatenate([scan.points for scan in scans]),
        np.concatenate(faces) if faces else None,
        np.concatenate(normals) if len(normals) == len(scans) else None,
        np.concatenate(sensors) if len(sensors) == len(scans) else None,
        tuple(note for scan in scans for note in scan.notes),
        scans[0].unit,
    )


def incomplete(path: Path, reason: object) -> ScanReadError:
    """The error for a file that is truncated, damaged, or not of the format of its suffix."""
    if isinstance(reason, UnicodeError):
        reason = "it holds bytes that are no text"  # instead of the message of the codec
    words = str(reason).splitlines() or [type(reason).__name__]
    return ScanReadError(
        f"not a complete {path.suffix[1:].upper()} file ({words[0]}): export or copy it again"
    )
