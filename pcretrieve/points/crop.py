"""Raw points → points of the body: invalid readings, background, ground and strays removed."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import ReconstructionError, Stage
from pcretrieve.options import ScanOptions
from pcretrieve.points.clean import FEWEST_POINTS, check_extent
from pcretrieve.points.grid import touching
from pcretrieve.points.ground import Ground, ground_of
from pcretrieve.values import FloatArray, PointCloud, Step, bounding_diagonal

# A depth camera writes one range, 0 or the largest that its format has, for each ray without an answer. Such
# ranges are equal within the tolerance, and the largest one is no measurement if all others are smaller than
# this fraction of it. A single point may be real.
SAME_RANGE = 1e-5
MEASURED = 0.5
FEWEST_READINGS = 2

# Distance from the median point, in median distances, beyond which a point is an error. They are not removed
# if there are more than this fraction of them, because they may be a second body.
FAR_AWAY = 20
MOST_FAR_POINTS = 0.05

# Strays are outside a box: that from this quantile of each coordinate to 1 − the quantile, with a margin on
# every side, relative to the diagonal of the box.
STRAY_QUANTILE = 0.005
STRAY_MARGIN = 0.25


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
            f"ground_{axis}": float(x) for axis, x in zip("xyz", kept.ground.place, strict=True)
        }
        sizes |= {f"up_{axis}": float(x) for axis, x in zip("xyz", kept.ground.up, strict=True)}
    return cropped.after(Step("crop", time.perf_counter() - started, sizes, kept.notes))


def kept_points(cloud: PointCloud, options: ScanOptions, *, of_view: bool = False) -> Kept:
    """Find the points of a cloud that a crop keeps, as in `crop`."""
    points, viewpoints = cloud.points, cloud.viewpoints
    kept, notes = np.ones(len(points), dtype=np.bool_), []

    def remove(rest: NDArray[np.bool_], what: str) -> None:
        """Keep those of the kept points that are in the mask `rest`, (k,)."""
        if not rest.all():
            notes.append(f"dropped {(~rest).sum()} of {len(rest)} points {what}")
            kept[kept] = rest

    seen = points if viewpoints is None else points - viewpoints  # (n, 3)
    ranges = np.linalg.norm(seen, axis=1)
    is_ahead = bool(
        (seen[:, 2] >= 0).all() or (seen[:, 2] <= 0).all()
    )  # of the sensor, along the axis z
    readings = (ranges, abs(seen[:, 2])) if is_ahead else (ranges,)
    remove(_measured(readings), "at one range: readings without an answer")
    if not isinstance(options.min_range, str):
        remove(ranges[kept] >= options.min_range, f"nearer than min_range = {options.min_range:g}")
    if not isinstance(options.max_range, str):
        remove(ranges[kept] <= options.max_range, f"farther than max_range = {options.max_range:g}")
    if not isinstance(options.box, str):
        low, high = np.asarray(options.box)
        remove(((points[kept] >= low) & (points[kept] <= high)).all(axis=1), "outside the box")
    if not of_view:
        remove(_near(points[kept]), f"more than {FAR_AWAY} median distances from the middle")
    ground = None
    if options.ground == "auto" and not of_view and kept.sum() >= FEWEST_POINTS:
        ground = ground_of(points[kept], None if viewpoints is None else viewpoints[kept])
        if ground is not None:
            remove(~ground.points, "of the ground on which the body stands")
    if options.keep_largest and kept.any():
        gap = options.piece_gap * bounding_diagonal(points[kept])
        remove(_largest_piece(points[kept], gap), "that are not of the largest piece")
    if not of_view:
        before = bounding_diagonal(points[kept])
        remove(_without_strays(points[kept]), "as strays outside the box of their quantiles")
        if (after := bounding_diagonal(points[kept])) < before:
            notes.append(
                f"lengths are relative to a diagonal of {after:.4g}, with the strays {before:.4g}"
            )
    return Kept(kept, ground, tuple(notes))


def _measured(readings: tuple[FloatArray, ...]) -> NDArray[np.bool_]:
    """(n,) mask of the points whose range, and depth along the axis z, is a measurement."""
    result = np.ones(len(readings[0]), dtype=np.bool_)
    if len(result) < FEWEST_POINTS:
        return result
    at_sensor = readings[0] == 0
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


def _near(points: FloatArray) -> NDArray[np.bool_]:
    """(n,) mask of the points that are not far away, if those that are may be errors."""
    if len(points) < FEWEST_POINTS:
        return np.ones(len(points), dtype=np.bool_)
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
    if len(points) < FEWEST_POINTS:
        return np.ones(len(points), dtype=np.bool_)
    low, high = np.quantile(points, [STRAY_QUANTILE, 1 - STRAY_QUANTILE], axis=0)
    margin = STRAY_MARGIN * np.linalg.norm(high - low)
    return np.asarray(((points >= low - margin) & (points <= high + margin)).all(axis=1))
