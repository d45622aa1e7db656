"""Global registration: range scans (views) with unknown or rough poses → one cloud."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from pcretrieve.errors import InputError
from pcretrieve.options import MergeOptions, ScanOptions
from pcretrieve.pipeline.registration.alignment import (
    Overlap,
    Poses,
    adjusted,
    moved,
    overlap,
    shared,
    turned,
)
from pcretrieve.pipeline.registration.groups import COARSE, FINE, largest_group
from pcretrieve.pipeline.registration.tracking import followed, posed_track, tracks
from pcretrieve.pipeline.registration.views import View, placed_by, prepared
from pcretrieve.points.clean import averaged
from pcretrieve.values import FloatArray, PointCloud, Step

# Smallest overlap of two views that is reported; fraction of the points of one of them.
LEAST_SHARE = 0.02

# Largest distance of a view from the others, relative to the noise: it is 1.0 to 1.25 if the poses are right.
MOST_APART = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Merged:
    """Registered views.

    poses: (v, 4, 4) float64, rigid motion of each view into this frame; NaN if the view was left out.
    shares: (v,) float64, fraction of the points of each view that another registered view measured too; 0 if
        it was left out.
    scale: median diagonal of the views, to which relative options refer; unit of the file.
    names: the file of each view, if the views are files.
    """

    cloud: PointCloud
    poses: FloatArray
    shares: FloatArray
    overlaps: tuple[Overlap, ...]
    scale: float
    names: tuple[str, ...] = ()

    @property
    def left_out(self) -> tuple[int, ...]:
        """Numbers of the views that could not be registered."""
        return tuple(np.flatnonzero(np.isnan(self.poses[:, 0, 0])).tolist())

    def rms(self, view: int | None = None) -> float:
        """The root mean square distance of overlaps, weighted by their shares."""
        chosen = [
            pair for pair in self.overlaps if view in (None, pair.first, pair.second)
        ]
        if not chosen:
            return np.nan
        squares = [pair.rms**2 for pair in chosen]
        return float(
            np.sqrt(np.average(squares, weights=[pair.share for pair in chosen]))
        )


def merge_views(
    views: Sequence[PointCloud],
    options: MergeOptions,
    near: ScanOptions,
    *,
    poses: FloatArray | None = None,
) -> Merged:
    """Register range scans, each in a frame of its own and all in one unit, and merge them into one cloud.

    near: of its options, max_range is that of the views.
    poses: (v, 4, 4) float64, optional, rigid motions of the views into a common frame. They are refined if
        ``options.refine`` is set, by key frames if views hardly differ, and no view is left out. Without them
        all poses are searched, and views that are not in the largest group are left out, with a note in the
        provenance.
    Returns Merged: equal views and options give equal results, bit for bit.
    """
    started = time.perf_counter()
    if len(views) < 2:
        raise InputError(f"merging needs at least two views, got {len(views)}")
    if poses is not None:
        _check_poses(poses, len(views))
    rng = np.random.default_rng(options.seed)
    ready, scale, notes = prepared(views, options, near, rng)
    cell, reach = options.cell * scale, options.reach * scale
    if poses is None:
        keys, placed, key_of = _found(ready, cell, reach, options, rng)
    else:
        keys, placed, key_of = _refined(ready, poses, reach, options)
    all_poses, shares = _of_all(ready, keys, placed, reach)
    cloud = _joined(
        [ready[number].cloud for number in sorted(placed)], all_poses[sorted(placed)]
    )
    if options.voxel:
        cloud = averaged(cloud, options.voxel * scale)[0]
    sizes = {
        "views": float(len(views)),
        "placed": float(len(placed)),
        "points": float(len(cloud.points)),
    }
    overlaps = _overlaps(ready, keys, placed, key_of, reach)
    notes += [*_notes(keys, placed, shares, options), *_standing_off(overlaps)]
    notes += [
        f"left out view {number}: it has no place where it shares a surface with the others; "
        f"{placed_by(view, options, near)}"
        for number, view in enumerate(views)
        if number not in placed
    ]
    step = Step("merge", time.perf_counter() - started, sizes, tuple(notes))
    return Merged(cloud.after(step), all_poses, shares, overlaps, scale)


# The poses of the key frames and of all views that have a place, by number, and the key frame of each view.
Located = tuple[dict[int, FloatArray], dict[int, FloatArray], Mapping[int, int]]


def _found(
    views: Sequence[View],
    cell: float,
    reach: float,
    options: MergeOptions,
    rng: np.random.Generator,
) -> Located:
    """Search the poses of views: tracks of a sequence first, then the groups that fit each other."""
    found = tracks(views, reach, options)
    groups = [
        adjusted(views, keys, fixed=[min(keys)], steps=COARSE, reach=reach)
        for keys in (track.key_poses for track in found)
    ]
    keys = largest_group(views, groups, cell, reach, options, rng)
    return keys, *followed(views, keys, found, reach, options)


def _refined(
    views: Sequence[View], poses: FloatArray, reach: float, options: MergeOptions
) -> Located:
    """Refine the poses (v, 4, 4) of views, if the options say so."""
    placed = dict(enumerate(np.array(poses, dtype=np.float64)))
    if not options.refine:
        return placed, placed, {number: number for number in placed}
    track = posed_track(views, placed, reach, options)
    keys = track.key_poses
    keys = adjusted(views, keys, fixed=[min(keys)], steps=(*COARSE, *FINE), reach=reach)
    return keys, *followed(views, keys, [track], reach, None)


def _of_all(
    views: Sequence[View], keys: dict[int, FloatArray], placed: Poses, reach: float
) -> tuple[FloatArray, FloatArray]:
    """The poses and the shares of all views, as in `Merged`."""
    poses, shares = np.full((len(views), 4, 4), np.nan), np.zeros(len(views))
    for number, pose in placed.items():
        poses[number] = pose
        shares[number] = shared(views, keys | {number: pose}, number, reach)
    return poses, shares


def _notes(
    keys: Poses, placed: Poses, shares: FloatArray, options: MergeOptions
) -> Iterator[str]:
    """Say which views have key frames, or little in common with the others."""
    if len(keys) < len(placed):
        yield f"registered {len(placed)} views of a sequence by {len(keys)} key frames"
    for number in placed:
        if shares[number] < options.min_overlap:
            yield f"view {number} shares only {shares[number]:.1%} of its points with the others"


def _overlaps(
    views: Sequence[View],
    keys: Poses,
    placed: Poses,
    key_of: Mapping[int, int],
    reach: float,
) -> tuple[Overlap, ...]:
    """The overlaps of all key frames, and of each view and its key frame, that are worth a report."""
    pairs = [
        *combinations(keys, 2),
        *((key, view) for view, key in key_of.items() if key != view),
    ]
    ordered = sorted((min(pair), max(pair)) for pair in pairs)
    overlaps = [overlap(views, placed, first, second, reach) for first, second in ordered]
    return tuple(pair for pair in overlaps if pair.share >= LEAST_SHARE)


def _standing_off(overlaps: Sequence[Overlap]) -> list[str]:
    """A note for each view whose surface is farther from that of the others than noise allows.

    The worst is left out before the others are compared, because it stands off them too.
    """
    notes = []
    pairs = np.array([(pair.first, pair.second) for pair in overlaps])  # (p, 2)
    values = np.array(
        [pair.share * np.array([1, pair.apart, pair.noise]) for pair in overlaps]
    )
    left = np.ones(len(pairs), dtype=np.bool_)
    while left.any():
        views = pairs[left].ravel()
        share, apart, noise = (
            np.bincount(views, column.repeat(2)) for column in values[left].T
        )
        times = apart / np.maximum(noise, np.finfo(np.float64).tiny)
        worst = times.argmax()
        if times[worst] <= MOST_APART:
            break
        notes.append(
            f"view {worst} stands {apart[worst] / share[worst]:.2g} off the others, {times[worst]:.1f} times "
            "the noise: refine its pose, scan it again, or leave it out"
        )
        left &= (pairs != worst).all(axis=1)
    return notes


def _check_poses(poses: FloatArray, n_views: int) -> None:
    if poses.shape != (n_views, 4, 4):
        raise InputError(
            f"poses must have shape ({n_views}, 4, 4), one for each view, got {poses.shape}"
        )
    turns = poses[:, :3, :3]
    rigid = np.allclose(turns @ turns.transpose(0, 2, 1), np.eye(3), atol=1e-4)
    if not (
        rigid
        and (np.linalg.det(turns) > 0).all()
        and np.allclose(poses[:, 3], [0, 0, 0, 1])
    ):
        raise InputError(
            "poses must be rigid motions: a rotation, a translation, and a last row 0 0 0 1"
        )


def _joined(clouds: Sequence[PointCloud], poses: FloatArray) -> PointCloud:
    """The concatenation of all clouds, in the common frame."""
    parts = [
        (
            moved(pose, cloud.points),
            turned(pose, cloud.normals),
            moved(pose, cloud.viewpoints),
        )
        for cloud, pose in zip(clouds, poses, strict=True)
        if cloud.normals is not None and cloud.viewpoints is not None
    ]
    points, normals, viewpoints = (
        np.concatenate(arrays) for arrays in zip(*parts, strict=True)
    )
    return PointCloud(points, normals, viewpoints)
