"""Range scans → their foreground: the body, without floors, walls and far points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import ReconstructionError, Stage
from pcretrieve.options import MergeOptions, ScanOptions
from pcretrieve.points import kept_points
from pcretrieve.points.ground import fitted_plane
from pcretrieve.values import FloatArray, PointCloud, bounding_diagonal

__all__ = ["NORMAL_NEIGHBORS", "foreground"]

# Fewest neighbours for a normal; a view must have more points.
NORMAL_NEIGHBORS = 16

# Number of points by which planes are compared, number of planes, number of neighbours among the compared
# points to which each is fitted, and largest number of planes that are removed.
COMPARED = 2000
N_PLANES = 400
N_NEAR = 100
MOST_PLANES = 4

# Largest distance of a point from the plane to which it belongs: four standard deviations of the points to
# which the plane was fitted, because the noise of depth cameras grows with the range; but within these
# fractions of the diagonal. Points are removed up to so many median distances from their plane, which is four
# standard deviations too.
DEVIATIONS = 4.0
THINNEST, THICKEST = 0.003, 0.03
REMOVED = 6.0

# A plane of the background has at least this fraction of the points, and extends over this fraction of the
# diagonal; at most this fraction of the points are behind it; and this fraction of the points is in front.
LEAST_SHARE = 0.1
LEAST_EXTENT = 0.5
MOST_BEHIND = 0.02
LEAST_LEFT = 0.03

# At least this fraction of the points on a plane are nearer to it than half the thickness: .95 of a plane
# with noise, .5 of a slice of a body.
LEAST_CENTRAL = 0.9


def foreground(cloud: PointCloud, sensor: FloatArray, number: int, options: MergeOptions) -> FloatArray:
    """The points of a view that are of the body.

    sensor: (3,) float64, its position.
    Returns (n, 3) float64: the points within `max_range`, in front of the planes of the background, and of
        the largest component, if these options are set.
    """
    near = ScanOptions(max_range="none" if options.max_range is None else options.max_range)
    kept = kept_points(PointCloud(cloud.points, viewpoints=sensor), near, of_view=True)
    points: FloatArray = cloud.points[kept.points]
    if options.background == "planes":
        points = _in_front_of_planes(points, sensor)
    if options.keep_largest and len(points):
        largest = ScanOptions(keep_largest=True, piece_gap=options.piece_gap)
        points = points[kept_points(PointCloud(points, viewpoints=sensor), largest, of_view=True).points]
    if len(points) <= NORMAL_NEIGHBORS or not bounding_diagonal(points):
        raise ReconstructionError(
            f"view {number} must have more than {NORMAL_NEIGHBORS} different points in reach, got "
            f"{len(points)}: leave it out, or raise max_range",
            stage=Stage.MERGE,
        )
    return points


def _in_front_of_planes(points: FloatArray, sensor: FloatArray) -> FloatArray:
    """The points in front of the largest planes behind which there is nothing."""
    rng = np.random.default_rng(0)
    for _ in range(MOST_PLANES):
        mask = _background_plane(points, sensor, rng)
        if mask is None:
            break
        points = points[~mask]
    return points


def _background_plane(
    points: FloatArray, sensor: FloatArray, rng: np.random.Generator
) -> NDArray[np.bool_] | None:
    """(n,) mask of the points on a plane of the background and behind it; None if there is no such plane."""
    if len(points) <= NORMAL_NEIGHBORS:
        return None
    few = points[rng.permutation(len(points))[:COMPARED]]
    middle, diagonal = few.mean(axis=0), bounding_diagonal(few)
    normals, offsets, deviation = _fitted_planes(few - middle, rng)
    thickness = np.clip(DEVIATIONS * deviation, THINNEST * diagonal, THICKEST * diagonal)  # (p,)
    towards = np.where(normals @ (sensor - middle) > offsets, 1, -1)  # (p,)
    heights = towards[:, None] * (normals @ (few - middle).T - offsets[:, None])  # (p, s): in front
    on = (abs(heights) <= thickness[:, None]).mean(axis=1)
    central = (abs(heights) <= thickness[:, None] / 2).mean(axis=1)
    front = (heights > thickness[:, None]).mean(axis=1)
    possible = (1 - on - front <= MOST_BEHIND) & (on >= LEAST_SHARE) & (front >= LEAST_LEFT)
    possible &= central >= LEAST_CENTRAL * on
    if not possible.any():
        return None
    best = int(np.where(possible, on, 0).argmax())
    inliers = few[abs(heights[best]) <= thickness[best]]
    if bounding_diagonal(inliers) < LEAST_EXTENT * diagonal:
        return None
    _, height = fitted_plane(points, inliers, towards[best] * normals[best], thickness[best])
    on_plane = abs(height) <= thickness[best]
    return np.asarray(height <= min(thickness[best], REMOVED * float(np.median(abs(height[on_plane])))))


def _fitted_planes(points: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Normals (p, 3), offsets (p,) and root mean square distances (p,) of planes of neighbours."""
    from scipy.spatial import cKDTree

    first = points[rng.integers(len(points), size=N_PLANES)]
    near = points[np.asarray(cKDTree(points).query(first, k=min(N_NEAR, len(points)))[1])]  # (p, k, 3)
    centres = near.mean(axis=1)  # (p, 3)
    off = near - centres[:, None]
    squares, axes = np.linalg.eigh(np.einsum("pki,pkj->pij", off, off) / near.shape[1])
    normals = axes[:, :, 0]
    return normals, np.einsum("pi,pi->p", normals, centres), np.sqrt(np.maximum(squares[:, 0], 0))
