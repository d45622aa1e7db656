"""Range scans → their foreground: the body, without floors, walls and far points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import InputError, ReconstructionError, Stage
from pcretrieve.formats.conf import SENSOR_DISTANCE
from pcretrieve.options import MergeOptions, ScanOptions
from pcretrieve.points import kept_points, open3d
from pcretrieve.points.ground import fitted_plane
from pcretrieve.points.open3d import feature_histograms
from pcretrieve.points.register.range_image import RangeImage
from pcretrieve.values import FloatArray, PointCloud, bounding_diagonal

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
        largest = ScanOptions(keep_largest=True)
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


# Radius of the neighbourhood of a feature, in voxels. It is of the size of distinctive parts of a body.
FEATURE_RADIUS = 6

# Number of points of each view for registration and verification.
SOME_POINTS = 1000


class View(NamedTuple):
    """A range scan: the points that one sensor measured from one position, prepared for registration.

    points, normals: (k, 3) float64, one point in each voxel.
    sample: (s,) int, positions of a random sample of these points.
    feet: (n, 3) float64, the points of the tangent planes: the foot of the perpendicular from each point of
        the cloud to the least-squares plane of its neighbours.
    spacing: median distance from a point to its nearest neighbour; unit of the file.
    """

    cloud: PointCloud
    points: FloatArray
    normals: FloatArray
    sample: NDArray[np.intp]
    image: RangeImage
    tree: Any
    feet: FloatArray
    spacing: float


def prepared(
    clouds: Sequence[PointCloud], options: MergeOptions, rng: np.random.Generator
) -> tuple[list[View], float]:
    """Prepare range scans for registration.

    clouds: the points that one sensor measured from one position, each in a frame of its own; all in one
        unit.
    Returns scale : float: median diagonal of the views, to which relative options refer; unit of the points.
    """
    sensors = [_sensor(cloud, number, options) for number, cloud in enumerate(clouds)]
    fronts = [
        foreground(cloud, sensor, number, options)
        for number, (cloud, sensor) in enumerate(zip(clouds, sensors, strict=True))
    ]
    scale = float(np.median([bounding_diagonal(points) for points in fronts]))
    views = [
        _view(points, sensor, options, options.cell * scale, rng)
        for points, sensor in zip(fronts, sensors, strict=True)
    ]
    return views, scale


def one_of_each_cell(points: FloatArray, cell: float) -> NDArray[np.intp]:
    """Voxel-grid subsampling: the first point in each voxel.

    points: (n, 3) float64, coordinates.
    cell: edge of a voxel, unit of the points; 0 selects every point.
    Returns (k,) int: positions of the points, ascending.
    """
    if not cell:
        return np.arange(len(points))
    _, first = np.unique(np.floor(points / cell), axis=0, return_index=True)
    return np.sort(first)


def _sensor(view: PointCloud, number: int, options: MergeOptions) -> FloatArray:
    """(3,) position of the sensor; a conventional one, if the view has none."""
    if not len(view.points):
        raise ReconstructionError(f"view {number} has no points: leave it out", stage=Stage.MERGE)
    if view.viewpoints is not None:
        if bounding_diagonal(view.viewpoints) > options.reach * view.diagonal:
            raise InputError(
                f"a view must be seen by one sensor, view {number} was seen by several: merge the scans that "
                "it was made of"
            )
        return np.asarray(view.viewpoints.mean(axis=0))
    if options.sensor == "origin":
        return np.zeros(3)
    if options.max_range is not None:
        raise InputError(
            f"max_range is measured from the sensor, and view {number} does not say where that is: take "
            "sensor 'origin' if it is the origin of its frame"
        )
    middle = (view.points.min(axis=0) + view.points.max(axis=0)) / 2
    return np.asarray(middle + np.array([0, 0, SENSOR_DISTANCE * view.diagonal]))


def features_of(view: View, cell: float) -> FloatArray:
    """Features of the points of a view that are matched.

    cell: edge of the voxels of which each gave one point; unit of the points.
    Returns (k, 33) float64: fast point feature histograms of `View.points`.
    """
    return feature_histograms(view.points, view.normals, radius=FEATURE_RADIUS * cell)


def _view(
    points: FloatArray, sensor: FloatArray, options: MergeOptions, cell: float, rng: np.random.Generator
) -> View:
    """The view of points without background, thinned by voxels of the edge `cell`."""
    from scipy.spatial import cKDTree

    k = min(options.normal_neighbors, len(points))
    normals = open3d.estimate_normals(points, n_neighbors=k)
    normals[np.einsum("ij,ij->i", normals, sensor - points) < 0] *= -1
    few = one_of_each_cell(points, cell)
    tree = cKDTree(points)
    distance, near = map(np.asarray, tree.query(points, k=k))  # (n, k), (n, k)
    height = np.einsum("ij,ij->i", points[near].mean(axis=1) - points, normals)
    return View(
        PointCloud(points, normals, sensor),
        points[few],
        normals[few],
        rng.permutation(len(few))[:SOME_POINTS],
        RangeImage(points, normals, sensor),
        tree,
        points + height[:, None] * normals,
        float(np.median(distance[few, 1])),
    )
