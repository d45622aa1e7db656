"""Raw points → points of the body: invalid readings, background, ground and strays removed."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.arrays import tangent_axes, unit_vectors
from pcretrieve.errors import ReconstructionError, Stage
from pcretrieve.options import ScanOptions
from pcretrieve.points.clean import FEWEST_POINTS, check_extent
from pcretrieve.points.neighbors import PLANE_NEIGHBORS, neighborhoods, noise
from pcretrieve.points.voxels import touching
from pcretrieve.values import FloatArray, PointCloud, Step, bounding_diagonal

# A depth camera writes one range, 0 or the largest that its format has, for each ray without an answer. Such
# ranges are equal within the tolerance, and the largest one is no measurement if all others are smaller than
# this fraction of it. A single point may be real.
SAME_RANGE = 1e-5
MEASURED = 0.5
FEWEST_READINGS = 2

# Largest range of a reading at the sensor, relative to this quantile of the ranges: the positions of sensors
# have rounding errors, many readings may be there, and a few a million times as far as the others.
AT_SENSOR = 1e-6
USUAL_RANGE = 0.75

# Distance from the median point, in median distances, beyond which a point is an error. They are not removed
# if there are more than this fraction of them, because they may be a second body.
FAR_AWAY = 20
MOST_FAR_POINTS = 0.05

# Strays are outside a box: that from this quantile of each coordinate to 1 − the quantile, with a margin on
# every side, relative to the diagonal of the box.
STRAY_QUANTILE = 0.005
STRAY_MARGIN = 0.25

# Number of points by which planes are compared, and from which the three points of each plane are chosen;
# number of planes; number of neighbours of the first point among which the second and the third are.
COMPARED = 2000
N_PLANES = 400
N_NEAR = 100

# Largest distance of a point from the plane to which it belongs: relative to the diagonal, and in units of
# the noise, whichever is larger. Points are removed to a smaller distance, in units of the median of these
# distances, which leaves more of the soles; at least the last, relative to the diagonal.
THICKNESS = 0.003
THICKNESS_OF_NOISE = 4.0
REMOVED = 7.5
LEAST_REMOVED = 0.0005

# Smallest fraction of all points on the ground and on the body, and largest fraction beneath the ground.
LEAST_SHARE = 0.05
MOST_BENEATH = 0.02

# A body stands on a plane, if its lowest points, up to a quantile, are at most this high above the plane;
# relative to the diagonal.
LOWEST = 0.02
STANDING = 0.05

# The ground must be seen around the body: farther from its middle than the quantile of its points, times the
# factor, in most of the sectors. The soles of a closed body are not: they end where its sides begin.
N_SECTORS = 8
N_AROUND = 6
OUTLINE = 0.99
BEYOND = 1.05
FEWEST_BEYOND = 3


class Ground(NamedTuple):
    """A plane on which a body stands.

    place: (3,) float64, the point of the plane beneath the body; unit of the file.
    up: (3,) float64, unit normal of the plane on the side of the body.
    points: (n,) bool, the points on the plane, and beneath it.
    """

    place: FloatArray
    up: FloatArray
    points: NDArray[np.bool_]


class Kept(NamedTuple):
    """What a crop keeps: (n,) a mask of the points; the ground; a note for each rule that removed points."""

    points: NDArray[np.bool_]
    ground: Ground | None
    notes: tuple[str, ...]


def crop(cloud: PointCloud, options: ScanOptions) -> PointCloud:
    """Remove the points that are not of the body; the others are not changed.

    In this order: readings without an answer, points out of range, outside the box, far away, of the ground,
    of other components, and strays. All lengths of later stages are relative to the diagonal of the bounding
    box of the points that are left, which strays therefore cannot stretch.

    If the ground was removed, the sizes of the step ``crop`` include the point of the ground beneath the
    body, `ground_x` to `ground_z`, in the unit of the file, and the unit normal of the ground, `up_x` to
    `up_z`.
    """
    started = time.perf_counter()
    kept = kept_points(cloud, options)
    n = int(kept.points.sum())
    if kept.notes and n < FEWEST_POINTS:
        raise ReconstructionError(
            f"the crop must leave at least {FEWEST_POINTS} points, it left {n} ({'; '.join(kept.notes)}): "
            "give a wider range or box in [scan], or set ground = 'none'",
            stage=Stage.CROP,
        )
    cropped = cloud.select(kept.points) if kept.notes else cloud
    check_extent(cropped.points, Stage.CROP)
    sizes: dict[str, float] = {"points_in": len(cloud.points), "points": n}
    if kept.ground is not None:
        sizes |= {
            f"ground_{axis}": float(x)
            for axis, x in zip("xyz", kept.ground.place, strict=True)
        }
        sizes |= {
            f"up_{axis}": float(x) for axis, x in zip("xyz", kept.ground.up, strict=True)
        }
    return cropped.after(Step("crop", time.perf_counter() - started, sizes, kept.notes))


def kept_points(
    cloud: PointCloud, options: ScanOptions, *, of_view: bool = False
) -> Kept:
    """Find the points of a cloud that a crop keeps, as in `crop`."""
    points, viewpoints = cloud.points, cloud.viewpoints
    kept, notes = np.ones(len(points), dtype=np.bool_), []
    left = points  # those that are kept

    def remove(rest: NDArray[np.bool_], what: str) -> None:
        """Keep those of the kept points that are in the mask `rest`, (k,)."""
        nonlocal left
        if not rest.all():
            notes.append(f"dropped {(~rest).sum()} of {len(rest)} points {what}")
            kept[kept] = rest
            left = left[rest]

    seen = points if viewpoints is None else points - viewpoints  # (n, 3)
    ranges = np.linalg.norm(seen, axis=1)
    # Of the sensor, along the axis z.
    is_ahead = bool((seen[:, 2] >= 0).all() or (seen[:, 2] <= 0).all())
    readings = (ranges, abs(seen[:, 2])) if is_ahead else (ranges,)
    del seen  # as large as the scan
    # Of fewer points none stand out, and a crop that leaves them is an error.
    if len(points) >= FEWEST_POINTS:
        remove(_measured(readings), "at one range: readings without an answer")
    if not isinstance(options.min_range, str):
        remove(
            ranges[kept] >= options.min_range,
            f"nearer than min_range = {options.min_range:g}",
        )
    if not isinstance(options.max_range, str):
        remove(
            ranges[kept] <= options.max_range,
            f"farther than max_range = {options.max_range:g}",
        )
    if not isinstance(options.box, str):
        low, high = np.asarray(options.box)
        remove(((left >= low) & (left <= high)).all(axis=1), "outside the box")
    is_body = not of_view and len(left) >= FEWEST_POINTS
    if is_body:
        remove(_near(left), f"more than {FAR_AWAY} median distances from the middle")
    ground = None
    if options.ground == "auto" and is_body:
        ground = ground_of(left, None if viewpoints is None else viewpoints[kept])
        if ground is not None:
            remove(~ground.points, "of the ground on which the body stands")
    if options.keep_largest and kept.any():
        gap = options.piece_gap * bounding_diagonal(left)
        remove(_largest_piece(left, gap), "that are not of the largest piece")
    if is_body:
        before = bounding_diagonal(left)
        remove(_without_strays(left), "as strays outside the box of their quantiles")
        if (after := bounding_diagonal(left)) < before:
            notes.append(
                f"lengths are relative to a diagonal of {after:.4g}, with the strays {before:.4g}"
            )
    return Kept(kept, ground, tuple(notes))


def _measured(readings: tuple[FloatArray, ...]) -> NDArray[np.bool_]:
    """(n,) mask of the points whose range, and depth along the axis z, is a measurement."""
    result = np.ones(len(readings[0]), dtype=np.bool_)
    at_sensor = are_at_sensor(readings[0])
    if FEWEST_READINGS <= at_sensor.sum() < len(result):
        result &= ~at_sensor
    for values in readings:
        top = values[result].max()
        highest = values >= (1 - SAME_RANGE) * top
        rest = values[result & ~highest]
        is_alone = len(rest) >= FEWEST_POINTS and rest.max() < MEASURED * top
        if is_alone and (result & highest).sum() >= FEWEST_READINGS:
            result &= ~highest
    return result


def are_at_sensor(ranges: FloatArray) -> NDArray[np.bool_]:
    """(n,) mask of the ranges, of which there is one at least, that are 0 but for rounding."""
    return ranges <= AT_SENSOR * np.quantile(ranges, USUAL_RANGE)


def _near(points: FloatArray) -> NDArray[np.bool_]:
    """(n,) mask of the points that are not far away, if those that are may be errors."""
    distance = np.linalg.norm(points - np.median(points, axis=0), axis=1)  # (n,)
    near: NDArray[np.bool_] = distance <= FAR_AWAY * np.median(distance)
    return near if (~near).sum() <= MOST_FAR_POINTS * len(near) else np.ones_like(near)


def _largest_piece(points: FloatArray, gap: float) -> NDArray[np.bool_]:
    """(n,) mask of the component with the most points, by 26-connected voxels of the edge `gap`."""
    if not gap:
        return np.ones(len(points), dtype=np.bool_)
    voxels, voxel = np.unique(np.floor(points / gap), axis=0, return_inverse=True)
    piece = touching(voxels)[voxel.ravel()]  # (n,)
    return np.asarray(piece == np.bincount(piece).argmax())


def _without_strays(points: FloatArray) -> NDArray[np.bool_]:
    """(n,) mask of the points in the box of their quantiles, with its margin."""
    low, high = np.quantile(points, [STRAY_QUANTILE, 1 - STRAY_QUANTILE], axis=0)
    margin = STRAY_MARGIN * np.linalg.norm(high - low)
    return np.asarray(((points >= low - margin) & (points <= high + margin)).all(axis=1))


# --- the ground -----------------------------------------------------------------------------------------


def ground_of(points: FloatArray, viewpoints: FloatArray | None = None) -> Ground | None:
    """Find the largest plane beneath a body, by random sample consensus (RANSAC [1]_).

    All other points must be on one side of the plane, with the sensors; the lowest of them near the plane;
    and points of the plane must surround them.

    References
    ----------
    .. [1] M. A. Fischler and R. C. Bolles, "Random sample consensus", Communications of the ACM 24 (1981).
    """
    rng = np.random.default_rng(0)
    some = np.sort(rng.permutation(len(points))[:COMPARED])
    few = points[some]
    diagonal = bounding_diagonal(few)
    if not diagonal:
        return None
    close = neighborhoods(points, PLANE_NEIGHBORS + 1, of_some=True)
    thickness = max(THICKNESS * diagonal, THICKNESS_OF_NOISE * noise(points, close))
    up, inliers = _largest_plane(few, thickness, rng)
    if not len(inliers):
        return None
    up, height = fitted_plane(points, inliers, up, thickness)
    on_plane = abs(height) <= thickness
    body = height > 2 * thickness
    if not (on_plane.mean() >= LEAST_SHARE and body.mean() >= LEAST_SHARE):
        return None
    stands = np.quantile(height[body], LOWEST) <= STANDING * diagonal
    is_seen = (
        viewpoints is None
        or ((viewpoints - points) @ up + height > 0)[on_plane].mean() > 0.5
    )
    is_beneath = (height < -thickness).mean() <= MOST_BENEATH
    if not (
        stands
        and is_seen
        and is_beneath
        and _is_around(points[some], up, on_plane[some], body[some])
    ):
        return None
    removed = np.clip(
        REMOVED * np.median(abs(height[on_plane])), LEAST_REMOVED * diagonal, thickness
    )
    centre = np.median(points[body], axis=0)
    place = centre - (height[body][0] + (centre - points[body][0]) @ up) * up
    return Ground(place, up, height <= removed)


def _largest_plane(
    few: FloatArray, thickness: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Find the plane with most points among random ones with hardly a point beneath.

    Returns its normal and its points (k, 3); none if each plane has too few.
    """
    middle = few.mean(axis=0)
    normals, offsets = _planes(few - middle, rng)
    heights = normals @ (few - middle).T - offsets[:, None]  # (planes, s)
    on = (abs(heights) <= thickness).mean(axis=1)
    above = (heights > thickness).mean(axis=1)
    # Three collinear points have no plane: all points are on it, and none are on the body.
    possible = (np.minimum(above, 1 - on - above) <= MOST_BENEATH) & (
        on <= 1 - LEAST_SHARE
    )
    best = int(np.where(possible, on, 0).argmax())
    up = normals[best] if above[best] > 0.5 * (1 - on[best]) else -normals[best]
    if not (possible[best] and on[best] >= LEAST_SHARE):
        return up, few[:0]
    return up, few[abs(heights[best]) <= thickness]


def _planes(
    points: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Unit normals (p, 3) and offsets (p,) of planes through three random points that are near each other.

    The normal is zero if the three points are collinear.
    """
    from scipy.spatial import cKDTree

    first = rng.integers(len(points), size=N_PLANES)
    k = min(N_NEAR, len(points))
    near = np.asarray(cKDTree(points).query(points[first], k=k)[1])  # (p, k)
    second, third = near[np.arange(N_PLANES), rng.integers(k, size=(2, N_PLANES))]
    a, b, c = points[first], points[second], points[third]
    normals = unit_vectors(np.cross(b - a, c - a))
    return normals, np.einsum("ij,ij->i", normals, a)


def fitted_plane(
    points: FloatArray, inliers: FloatArray, up: FloatArray, thickness: float
) -> tuple[FloatArray, FloatArray]:
    """The least-squares plane of its inliers, which are selected again in each of three steps.

    inliers: (k, 3) float64, the inliers of the first step, at least three.
    up: (3,) float64, a vector on the side of the plane to which its normal shall point.
    thickness: largest distance of an inlier from the plane.
    Returns normal, heights: (3,) unit normal, and (n,) signed distances of all points from the plane.
    """
    height = np.zeros(len(points))
    for _ in range(3):
        centre = inliers.mean(axis=0)
        _, _, axes = np.linalg.svd(inliers - centre, full_matrices=False)
        up = axes[2] if axes[2] @ up > 0 else -axes[2]
        height = (points - centre) @ up
        inliers = points[abs(height) <= thickness]
    return up, height


def _is_around(
    points: FloatArray, up: FloatArray, ground: NDArray[np.bool_], body: NDArray[np.bool_]
) -> bool:
    """Whether the ground is seen beyond the outline of the body, in most directions."""
    flat = points @ np.column_stack(tangent_axes(up))  # (s, 2)
    flat = flat - np.median(flat[body], axis=0)
    radius = np.linalg.norm(flat, axis=1)
    sector = (
        np.floor((np.arctan2(flat[:, 1], flat[:, 0]) / (2 * np.pi) + 0.5) * N_SECTORS)
        % N_SECTORS
    )
    n_around = 0
    for number in range(N_SECTORS):
        here = sector == number
        outline = (
            np.quantile(radius[body & here], OUTLINE) if (body & here).any() else 0.0
        )
        n_around += int((radius[ground & here] > BEYOND * outline).sum() >= FEWEST_BEYOND)
    return n_around >= N_AROUND
