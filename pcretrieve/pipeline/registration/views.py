"""Range scans → views: the points of the body, without floors and walls, and their range images."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import InputError, ReconstructionError, Stage
from pcretrieve.options import MergeOptions, ScanOptions
from pcretrieve.points.clean import FEWEST_POINTS
from pcretrieve.points.crop import (
    COMPARED,
    N_NEAR,
    N_PLANES,
    are_at_sensor,
    fitted_plane,
    kept_points,
)
from pcretrieve.points.normals import estimate_normals
from pcretrieve.values import SENSOR_DISTANCE, FloatArray, PointCloud, bounding_diagonal

# Fewest neighbours for a normal; a view must have more points.
NORMAL_NEIGHBORS = 16

# Largest number of planes that are removed as background.
MOST_PLANES = 4

# Largest distance of a point from the plane to which it belongs: four standard deviations of the points to
# which the plane was fitted, because the noise of depth cameras grows with the range; but within these
# fractions of the diagonal. Points are removed up to so many median distances from their plane, which is four
# standard deviations too.
DEVIATIONS = 4.0
THINNEST = 0.003
THICKEST = 0.03
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

# The histogram of ranges: number of bins, which grow with the range; the quantile at which they begin; the
# number of bins of which each has the mean; and the least share of points in a bin.
N_BINS = 60
LEAST_QUANTILE = 0.005
SMOOTHED = 3
SMALLEST_SHARE = 1e-4

# A valley is lower than the peaks beside it by this factor, and at least this fraction of all points is in
# front of the one at which the background begins.
DEEPER = 3.0
LEAST_FRONT = 0.1

# Number of points of each view for registration and verification.
SOME_POINTS = 1000


class View(NamedTuple):
    """A range scan: the points that one sensor measured from one position, prepared for registration.

    points, normals: (k, 3) float64, one point in each voxel.
    sample: (s,) int, positions of a random sample of these points.
    tree: k-d tree of all points.
    feet: (n, 3) float64, the points of the tangent planes: the foot of the perpendicular from each point of
        the cloud to the least-squares plane of its neighbours.
    spacing: median distance from a point to its nearest neighbour; unit of the file.
    noise: median distance from a point to the plane of its neighbours; unit of the file.
    """

    cloud: PointCloud
    points: FloatArray
    normals: FloatArray
    sample: NDArray[np.intp]
    image: RangeImage
    tree: Any
    feet: FloatArray
    spacing: float
    noise: float


def prepared(
    clouds: Sequence[PointCloud],
    options: MergeOptions,
    near: ScanOptions,
    rng: np.random.Generator,
) -> tuple[list[View], float, list[str]]:
    """The views; the median of their diagonals, to which relative options refer; notes on the background."""
    sensors = [
        _sensor(cloud, number, options, near) for number, cloud in enumerate(clouds)
    ]
    ranges, notes = [near.max_range] * len(clouds), []
    if options.background == "room" and near.max_range == "none":
        found = [depth_limit(cloud, options) for cloud in clouds]
        if known := [limit for limit in found if limit is not None]:
            # A body may have a valley of its own in some views.
            middle = float(np.median(known))
            ranges = [max(limit or middle, middle) for limit in found]
            notes.append(
                f"took max_range = {min(ranges):.3g} to {max(ranges):.3g} from the histograms of depths"
            )
    fronts = [
        _foreground(cloud, sensor, number, options, ScanOptions(max_range=most))
        for number, (cloud, sensor, most) in enumerate(
            zip(clouds, sensors, ranges, strict=True)
        )
    ]
    scale = float(np.median([bounding_diagonal(points) for points in fronts]))
    views = [
        _view(points, sensor, options, options.cell * scale, rng)
        for points, sensor in zip(fronts, sensors, strict=True)
    ]
    return views, scale, notes


def depth_limit(cloud: PointCloud, options: MergeOptions) -> float | None:
    """The range at which the background of a view begins: in the first valley of the histogram of ranges.

    None if there is no valley, or nobody knows where the sensor is. A floor fills the valley a little.
    """
    from scipy.ndimage import uniform_filter1d

    if cloud.viewpoints is None and options.sensor != "origin":
        return None
    seen = cloud.points if cloud.viewpoints is None else cloud.points - cloud.viewpoints
    ranges = np.linalg.norm(seen, axis=1)
    if len(ranges) >= FEWEST_POINTS:
        ranges = ranges[~are_at_sensor(ranges)]
    if len(ranges) < FEWEST_POINTS:
        return None
    edges = np.geomspace(np.quantile(ranges, LEAST_QUANTILE), ranges.max(), N_BINS + 1)
    shares = uniform_filter1d(np.histogram(ranges, edges)[0] / len(ranges), SMOOTHED)
    shares = np.maximum(shares, SMALLEST_SHARE)
    before, behind = (np.maximum.accumulate(one) for one in (shares, shares[::-1]))
    is_valley = DEEPER * shares <= np.minimum(before, behind[::-1])
    is_valley &= np.cumsum(shares) >= LEAST_FRONT
    if not is_valley.any():
        return None
    first = int(is_valley.argmax())
    length = int((~is_valley[first:]).argmax())
    # Behind the lowest bin, which has the mean of the bins beside it.
    return float(edges[first + shares[first : first + length].argmin() + 2])


def placed_by(cloud: PointCloud, options: MergeOptions, near: ScanOptions) -> str:
    """What would probably place a view that has no place, in words."""
    limit = depth_limit(cloud, options)
    if near.max_range == "none" and options.background != "room" and limit is not None:
        return f"it has a background, remove that by --max-range {limit:.2g}"
    if cloud.viewpoints is None and options.sensor == "front":
        return "if it is of a depth camera, give --sensor origin"
    if not options.keep_largest:
        return "if it shows more than the body, give --keep-largest"
    return "lower min_overlap in [merge], or add views between it and the others"


def _sensor(
    view: PointCloud, number: int, options: MergeOptions, near: ScanOptions
) -> FloatArray:
    """(3,) position of the sensor; a conventional one, if the view has none."""
    if not len(view.points):
        raise ReconstructionError(
            f"view {number} has no points: leave it out", stage=Stage.MERGE
        )
    if view.viewpoints is not None:
        if bounding_diagonal(view.viewpoints) > options.reach * view.diagonal:
            raise InputError(
                f"a view must be seen by one sensor, view {number} was seen by several: merge the scans that "
                "it was made of"
            )
        return np.asarray(view.viewpoints.mean(axis=0))
    if options.sensor == "origin":
        return np.zeros(3)
    if near.max_range != "none":
        raise InputError(
            f"max_range is measured from the sensor, and view {number} does not say where that is: take "
            "sensor 'origin' if it is the origin of its frame"
        )
    middle = (view.points.min(axis=0) + view.points.max(axis=0)) / 2
    return np.asarray(middle + np.array([0, 0, SENSOR_DISTANCE * view.diagonal]))


def _foreground(
    cloud: PointCloud,
    sensor: FloatArray,
    number: int,
    options: MergeOptions,
    near: ScanOptions,
) -> FloatArray:
    """The (n, 3) points within `max_range`, in front of the background, and of the largest component."""
    kept = kept_points(
        PointCloud(cloud.points, viewpoints=sensor), near, of_view=True
    ).points
    if cloud.viewpoints is None:
        # The sensor is perhaps elsewhere, but these are no readings.
        kept &= cloud.points.any(axis=1)
    points: FloatArray = cloud.points[kept]
    if options.background != "none":
        rng = np.random.default_rng(0)
        for _ in range(MOST_PLANES):
            behind = _background_plane(points, sensor, rng)
            if behind is None:
                break
            points = points[~behind]
    if options.keep_largest and len(points):
        largest = ScanOptions(keep_largest=True)
        points = points[
            kept_points(
                PointCloud(points, viewpoints=sensor), largest, of_view=True
            ).points
        ]
    if len(points) <= NORMAL_NEIGHBORS or not bounding_diagonal(points):
        raise ReconstructionError(
            f"view {number} must have more than {NORMAL_NEIGHBORS} different points in reach, got "
            f"{len(points)}: leave it out, or raise max_range",
            stage=Stage.MERGE,
        )
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
    thickness = np.clip(
        DEVIATIONS * deviation, THINNEST * diagonal, THICKEST * diagonal
    )  # (p,)
    towards = np.where(normals @ (sensor - middle) > offsets, 1, -1)  # (p,)
    # (p, s): in front.
    heights = towards[:, None] * (normals @ (few - middle).T - offsets[:, None])
    on = (abs(heights) <= thickness[:, None]).mean(axis=1)
    front = (heights > thickness[:, None]).mean(axis=1)
    possible = (
        (1 - on - front <= MOST_BEHIND) & (on >= LEAST_SHARE) & (front >= LEAST_LEFT)
    )
    # Near the middle of the plane, too.
    possible &= (abs(heights) <= thickness[:, None] / 2).mean(
        axis=1
    ) >= LEAST_CENTRAL * on
    if not possible.any():
        return None
    best = int(np.where(possible, on, 0).argmax())
    inliers = few[abs(heights[best]) <= thickness[best]]
    if bounding_diagonal(inliers) < LEAST_EXTENT * diagonal:
        return None
    _, height = fitted_plane(
        points, inliers, towards[best] * normals[best], thickness[best]
    )
    on_plane = abs(height) <= thickness[best]
    return np.asarray(
        height <= min(thickness[best], REMOVED * float(np.median(abs(height[on_plane]))))
    )


def _fitted_planes(
    points: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Normals (p, 3), offsets (p,) and root mean square distances (p,) of planes of neighbours."""
    from scipy.spatial import cKDTree

    first = points[rng.integers(len(points), size=N_PLANES)]
    near = points[
        np.asarray(cKDTree(points).query(first, k=min(N_NEAR, len(points)))[1])
    ]  # (p, k, 3)
    centres = near.mean(axis=1)  # (p, 3)
    off = near - centres[:, None]
    squares, axes = np.linalg.eigh(np.einsum("pki,pkj->pij", off, off) / near.shape[1])
    normals = axes[:, :, 0]
    return (
        normals,
        np.einsum("pi,pi->p", normals, centres),
        np.sqrt(np.maximum(squares[:, 0], 0)),
    )


def _view(
    points: FloatArray,
    sensor: FloatArray,
    options: MergeOptions,
    cell: float,
    rng: np.random.Generator,
) -> View:
    """The view of points without background, thinned by voxels of the edge `cell`."""
    from scipy.spatial import cKDTree

    k = min(options.normal_neighbors, len(points))
    normals = estimate_normals(points, n_neighbors=k)
    normals[np.einsum("ij,ij->i", normals, sensor - points) < 0] *= -1
    # One in each voxel.
    few = np.sort(np.unique(np.floor(points / cell), axis=0, return_index=True)[1])
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
        float(np.median(np.abs(height[few]))),
    )


# Edge of a pixel, in median distances of neighbouring rays, so that most pixels inside the silhouette contain
# a point; largest number of pixels along a side; and number of rays that are sampled for the median distance.
PIXEL = 2.0
LARGEST_SIDE = 512
SAMPLE = 2000

# Smallest cosine of the angle between the normals of corresponding points: 60 degrees.
LEAST_COSINE = 0.5


class Comparison(NamedTuple):
    """The comparison of points with a range image. A point that is occluded is in neither mask.

    agrees: (..., n) bool, points on the measured surface, with a similar normal.
    contradicts: (..., n) bool, points in space that the sensor observed as empty: between the sensor and the
        measured surface.
    """

    agrees: NDArray[np.bool_]
    contradicts: NDArray[np.bool_]


class RangeImage:
    """The central projection of points onto an image plane of their sensor.

    points, normals: (n, 3) float64, coordinates, and unit normals that point towards the sensor.
    sensor: (3,) float64, position of the sensor; unit of the points.
    """

    def __init__(
        self, points: FloatArray, normals: FloatArray, sensor: FloatArray
    ) -> None:
        from scipy import ndimage
        from scipy.spatial import cKDTree

        self._points, self._normals, self._sensor = points, normals, sensor
        ahead = points.mean(axis=0) - sensor
        ahead /= np.linalg.norm(ahead)
        right = np.cross(ahead, np.eye(3)[np.abs(ahead).argmin()])
        right /= np.linalg.norm(right)
        self._axes = np.stack([right, np.cross(ahead, right), ahead], axis=1)  # (3, 3)
        rays, depth = self._project(points)
        seen = rays[depth > 0]
        some = seen[:: max(1, len(rays) // SAMPLE)]
        spacing = np.asarray(cKDTree(seen).query(some, k=2)[0])[:, 1]
        self._low = seen.min(axis=0)
        extent = np.ptp(seen, axis=0)
        self._pixel = max(
            PIXEL * float(np.median(spacing)), float(extent.max()) / LARGEST_SIDE
        )
        # A border of empty pixels, to which all points outside the image are mapped.
        self._shape = np.floor(extent / self._pixel).astype(np.int64) + 3
        nearest = np.full(self._shape, -1)
        # The nearest point in a pixel is written last.
        order = np.argsort(-depth, kind="stable")
        nearest.ravel()[self._pixels(rays, depth)[order]] = order
        nearest[[0, -1], :] = nearest[:, [0, -1]] = -1
        self._nearest = nearest.ravel()
        # The smallest depth in each pixel and its eight neighbours, so that points of an inclined surface, or
        # at a depth edge, do not contradict the image.
        nearest_depth = np.where(nearest >= 0, depth[nearest], np.inf)
        self._front = np.asarray(
            ndimage.minimum_filter(nearest_depth, size=3, mode="nearest")
        ).ravel()

    def _project(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(..., 2) image coordinates, and (...) distances to the sensor; negative behind the sensor."""
        seen = (points - self._sensor) @ self._axes  # (..., 3)
        ahead = np.where(seen[..., 2] > 0, seen[..., 2], np.nan)
        depth = np.linalg.norm(seen, axis=-1)
        return seen[..., :2] / ahead[..., None], np.where(seen[..., 2] > 0, depth, -1.0)

    def _pixels(self, rays: FloatArray, depth: FloatArray) -> NDArray[np.int64]:
        """(...) number of the pixel of each ray; 0, an empty pixel, outside the image."""
        index = np.nan_to_num((rays - self._low) / self._pixel, nan=-1.0)
        index = (
            np.clip(np.floor(index), -1, self._shape - 2).astype(np.int64) + 1
        )  # (..., 2)
        return np.where(depth > 0, index[..., 0] * self._shape[1] + index[..., 1], 0)

    def compare(
        self, points: FloatArray, normals: FloatArray, *, tolerance: float
    ) -> Comparison:
        """Compare (..., n, 3) points and unit normals, in the frame of the view, with the image.

        tolerance: largest distance of a point that agrees from the tangent plane of the measured point, and
            smallest distance of a point that contradicts in front of the measured points around its ray.
        """
        rays, depth = self._project(points)
        pixel = self._pixels(rays, depth)
        nearest = self._nearest[pixel]
        there = nearest >= 0
        offset = points - self._points[nearest]
        facing = self._normals[nearest]
        on_plane = np.abs(np.einsum("...j,...j->...", offset, facing)) < tolerance
        near = np.linalg.norm(offset, axis=-1) < tolerance + 2 * self._pixel * depth
        alike = np.einsum("...j,...j->...", normals, facing) > LEAST_COSINE
        in_front = depth < self._front[pixel] - tolerance
        return Comparison(there & on_plane & near & alike, there & in_front)
