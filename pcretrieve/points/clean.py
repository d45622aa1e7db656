"""Points of a body → filtered points: voxel-grid filter, statistical outlier removal."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import ReconstructionError, Stage
from pcretrieve.options import ScanOptions
from pcretrieve.points.density import FARTHER, is_of_surface
from pcretrieve.points.neighbors import (
    PLANE_NEIGHBORS,
    Neighborhoods,
    among,
    neighborhoods,
    voxel_numbers,
)
from pcretrieve.values import FloatArray, PointCloud, Step

# Smallest number of points of a scan. With fewer points, limbs cannot be resolved.
FEWEST_POINTS = 100

# Smallest ratio of singular values of the centred points, below which the points are collinear or coplanar.
SMALLEST_THICKNESS = 1e-3

# Length of a mean of unit normals below which they cancel.
CANCELLED = 1e-3

# Edge of the voxels for averaging, relative to the diagonal: of dense clouds, which have at least DENSE
# points for each occupied voxel of this edge, and of other clouds. See docs/decisions.md, DENSE_VOXEL.
DENSE_VOXEL = 0.003
DENSE = 1.6
VOXEL = 0.0015

# Smallest mean distance of an outlier to its neighbours, in medians of it: 2.9 spacings of a surface.
# A limit by deviations alone makes dents in a clean surface. See docs/decisions.md, LEAST_OUTLYING.
LEAST_OUTLYING = 1.8

# The largest mean distance of a point of a surface that is sampled sparsely, in medians: that where the
# density is a hundredth is 10, those of strays between sparse parts of a body are 17 to 41.
MOST_SPARSE = 12


def clean(cloud: PointCloud, options: ScanOptions) -> tuple[PointCloud, Neighborhoods]:
    """Filter a cloud: average the points in each voxel, and remove statistical outliers.

    Returns the points that remain, and their neighbours among them, which later stages use.
    """
    started = time.perf_counter()
    check_extent(cloud.points, Stage.CLEAN)
    thinned, voxel = _thinned(cloud, options.voxel)
    check_extent(thinned.points, Stage.CLEAN)
    k = max(options.normal_neighbors, PLANE_NEIGHBORS + 1)
    neighbors = neighborhoods(
        thinned.points, max(options.outlier_neighbors, FARTHER + 1, k)
    )
    is_inlier = _inliers(thinned, voxel, neighbors, options)
    kept = thinned.select(np.flatnonzero(is_inlier))
    check_extent(kept.points, Stage.CLEAN)
    n_outliers = len(voxel) - int(is_inlier[voxel].sum())
    notes = (
        (f"dropped {n_outliers} of {len(voxel)} points as outliers",)
        if n_outliers
        else ()
    )
    sizes: dict[str, float] = {
        "points_in": len(voxel),
        "points_thinned": len(is_inlier),
        "points": len(kept.points),
        "outliers": n_outliers,
    }
    neighbors = among(kept.points, is_inlier, neighbors, k)
    return kept.after(
        Step("clean", time.perf_counter() - started, sizes, notes)
    ), neighbors


def outliers(cloud: PointCloud, options: ScanOptions) -> NDArray[np.bool_]:
    """(n,) mask of the points that `clean` removes: those in voxels that are outliers."""
    thinned, voxel = _thinned(cloud, options.voxel)
    neighbors = neighborhoods(thinned.points, max(options.outlier_neighbors, FARTHER + 1))
    return ~_inliers(thinned, voxel, neighbors, options)[voxel]


def _inliers(
    cloud: PointCloud,
    voxel: NDArray[np.intp],
    neighbors: Neighborhoods,
    options: ScanOptions,
) -> NDArray[np.bool_]:
    """Whether the mean distance of each point to its neighbours is not exceptional, (n,).

    What is exceptional, is so among the points of the scan: of a dense one, each point of the surface is the
    mean of a hundred, and each stray of one. A few in a thousand are then many of the means.
    """
    distance = neighbors.distance[:, : options.outlier_neighbors].mean(axis=1)  # (n,)
    # Points that coincide with all their neighbours do not count.
    counts = np.bincount(voxel) * (distance > 0)
    if np.count_nonzero(counts) < 2:
        return np.ones(len(distance), dtype=np.bool_)
    median = np.median(distance[counts > 0])
    mean = np.average(distance, weights=counts)
    deviation = np.sqrt(np.average((distance - mean) ** 2, weights=counts))
    limit = max(mean + options.outlier_std * deviation, LEAST_OUTLYING * median)
    # Where the points are sparse, distances are exceptional, and no points are outliers for that reason.
    sparse = is_of_surface(neighbors, cell=DENSE_VOXEL * cloud.diagonal)
    return np.asarray(
        (distance > 0) & ((distance < limit) | sparse & (distance < MOST_SPARSE * median))
    )


def _thinned(
    cloud: PointCloud, voxel: float | str
) -> tuple[PointCloud, NDArray[np.intp]]:
    """The mean of the points in each voxel, and the voxel of each point, (n,)."""
    if isinstance(voxel, str):
        numbers = np.sort(voxel_numbers(cloud.points, DENSE_VOXEL * cloud.diagonal))
        n_voxels = np.count_nonzero(np.diff(numbers, prepend=-1))
        voxel = DENSE_VOXEL if len(cloud.points) >= DENSE * n_voxels else VOXEL
    return (
        averaged(cloud, voxel * cloud.diagonal)
        if voxel
        else (cloud, np.arange(len(cloud.points)))
    )


def averaged(cloud: PointCloud, edge: float) -> tuple[PointCloud, NDArray[np.intp]]:
    """Voxel-grid filter: the mean of the points in each voxel, and the voxel of each point, (n,)."""
    _, first, group, counts = np.unique(
        voxel_numbers(cloud.points, edge),
        return_index=True,
        return_inverse=True,
        return_counts=True,
    )

    def average(values: FloatArray) -> FloatArray:
        sums = [np.bincount(group, weights=values[:, axis]) for axis in range(3)]
        return np.column_stack(sums) / counts[:, None]

    normals = None
    if cloud.normals is not None:
        normals = average(cloud.normals)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        # Opposite normals in one voxel cancel (both sides of a thin sheet): the first normal is kept.
        normals = np.where(
            length < CANCELLED, cloud.normals[first], normals / np.maximum(length, 1e-300)
        )
    # A mean of sensor positions is not a sensor position: the first position in the voxel is kept.
    viewpoints = None if cloud.viewpoints is None else cloud.viewpoints[first]
    return replace(
        cloud, points=average(cloud.points), normals=normals, viewpoints=viewpoints
    ), group


def check_extent(points: FloatArray, stage: str) -> None:
    """Check that points can be those of a body."""
    if len(points) < FEWEST_POINTS:
        raise ReconstructionError(
            f"a scan needs at least {FEWEST_POINTS} points, got {len(points)}: scan more densely, or lower "
            "scan.voxel",
            stage=stage,
        )
    centred = points - [column.mean() for column in points.T]
    # (3,): of the singular values.
    squares = np.linalg.eigvalsh(centred.T @ centred)[::-1]
    flat = squares < SMALLEST_THICKNESS**2 * squares[0]
    if squares[0] == 0 or flat[2]:
        what = (
            "are equal"
            if squares[0] == 0
            else "lie on a line"
            if flat[1]
            else "lie in a plane"
        )
        raise ReconstructionError(
            f"the points must span a body, all {len(points)} {what}: scan it from several sides",
            stage=stage,
        )
