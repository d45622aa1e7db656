"""Raw points → points that a surface can be fitted to."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pcretrieve.adapters import open3d
from pcretrieve.errors import ReconstructionError
from pcretrieve.options import ScanOptions
from pcretrieve.types import FloatArray, PointCloud, Step

__all__ = ["clean"]

# Fewer points than this say nothing about a body with limbs.
FEWEST_POINTS = 100

# Thickness over length below which points lie on a line or in a plane. The flattest bodies scanned here
# (an open hand) have 0.1.
SMALLEST_THICKNESS = 1e-3

# Points farther from the middle than this are no part of a body, in median distances; no point of a body
# seen so far is beyond 6. Depth cameras write such points where they saw nothing. They must go first, because
# every length is relative to the diagonal. More of them than this share may be a second body.
FAR_AWAY = 20
MOST_FAR_POINTS = 0.05

# Voxels that points are averaged in, relative to the diagonal: of dense clouds, with so many points in such a
# voxel on the average, and of others. NN and mAP of TOSCA, typical scans .921 .820, averaged in the voxels of
# dense ones .895 .823; with 100 000 points of the same noise .842 .757, averaged .921 .813.
DENSE_VOXEL = 0.003
DENSE = 1.6
VOXEL = 0.0015


def clean(cloud: PointCloud, options: ScanOptions) -> PointCloud:
    """Thin a cloud to one point per voxel and drop its strays.

    Returns
    -------
    PointCloud
        Averages of the points in each voxel, with their sensors; normals are dropped unless
        ``options.orientation`` can use them. In the unit of the file.

    Raises
    ------
    ReconstructionError
        If fewer than 100 points, or only a point, a line or a plane, is left.
    """
    started = time.perf_counter()
    near, notes = _without_far_points(cloud)
    _check_extent(near.points)
    thinned = _thinned(near, options.voxel)
    _check_extent(thinned.points)
    inliers = open3d.statistical_inliers(
        thinned.points, n_neighbors=options.outlier_neighbors, std_ratio=options.outlier_std
    )
    kept = thinned.select(inliers)
    _check_extent(kept.points)
    n_strays = len(thinned.points) - len(inliers)
    if n_strays:
        notes = (*notes, f"dropped {n_strays} of {len(thinned.points)} points as strays")
    step = Step(
        "clean",
        time.perf_counter() - started,
        {"points_in": len(cloud.points), "points_thinned": len(thinned.points), "points": len(inliers)},
        notes,
    )
    return kept.after(step)


def _without_far_points(cloud: PointCloud) -> tuple[PointCloud, tuple[str, ...]]:
    if len(cloud.points) < FEWEST_POINTS:
        return cloud, ()
    distance = np.linalg.norm(cloud.points - np.median(cloud.points, axis=0), axis=1)  # (n,)
    far = distance > FAR_AWAY * np.median(distance)
    if not 0 < far.sum() <= MOST_FAR_POINTS * len(far):
        return cloud, ()
    return cloud.select(~far), (
        f"dropped {far.sum()} of {len(far)} points more than {FAR_AWAY} median distances from the middle",
    )


def _thinned(cloud: PointCloud, voxel: float | str) -> PointCloud:
    if isinstance(voxel, str):
        n_voxels = len(np.unique(_voxels(cloud.points, DENSE_VOXEL * cloud.diagonal)))
        voxel = DENSE_VOXEL if len(cloud.points) >= DENSE * n_voxels else VOXEL
    return _averaged(cloud, voxel * cloud.diagonal) if voxel else cloud


def _voxels(points: FloatArray, edge: float) -> NDArray[np.int64]:
    """(n,) number of the voxel that each point lies in."""
    index = np.floor((points - points.min(axis=0)) / edge).astype(np.int64)  # (n, 3)
    sides = index.max(axis=0) + 1
    number: NDArray[np.int64] = (index[:, 0] * sides[1] + index[:, 1]) * sides[2] + index[:, 2]
    return number


def _averaged(cloud: PointCloud, edge: float) -> PointCloud:
    _, first, group, counts = np.unique(
        _voxels(cloud.points, edge), return_index=True, return_inverse=True, return_counts=True
    )

    def average(values: FloatArray) -> FloatArray:
        sums = [np.bincount(group, weights=values[:, axis]) for axis in range(3)]
        return np.column_stack(sums) / counts[:, None]

    normals = cloud.normals
    if normals is not None:
        normals = average(normals)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        # Opposite normals in one voxel cancel (a sheet seen from both sides): keep the first one's.
        cancelled = length[:, 0] < SMALLEST_THICKNESS
        normals = np.where(cancelled[:, None], cloud.normals[first], normals / np.maximum(length, 1e-300))  # type: ignore[index]
    return replace(
        cloud,
        points=average(cloud.points),
        normals=normals,
        # A mean of sensors is no sensor: the first point's stands for its voxel.
        viewpoints=None if cloud.viewpoints is None else cloud.viewpoints[first],
    )


def _check_extent(points: FloatArray) -> None:
    if len(points) < FEWEST_POINTS:
        raise ReconstructionError(
            f"a scan needs at least {FEWEST_POINTS} points, got {len(points)}: scan more densely, or lower "
            "scan.voxel",
            stage="clean",
        )
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False, full_matrices=False)  # (3,)
    flat = spread < SMALLEST_THICKNESS * spread[0]
    if spread[0] == 0 or flat[2]:
        what = "are equal" if spread[0] == 0 else "lie on a line" if flat[1] else "lie in a plane"
        raise ReconstructionError(
            f"the points must span a body, all {len(points)} {what}: scan it from several sides",
            stage="clean",
        )
