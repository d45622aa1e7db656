"""Range scans from unknown places → one cloud.

Any two views are matched, and views are grouped from the best match on, each group joined to another where
all sensors bear it out: where one saw a surface, no other may have seen through it. What fits nowhere is left
out, and said so.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import InputError, ReconstructionError
from pcretrieve.formats.views import SENSOR_DISTANCE
from pcretrieve.options import MergeOptions
from pcretrieve.registration.alignment import (
    NORMAL_NEIGHBORS,
    Poses,
    View,
    adjusted,
    moved,
    one_of_each_cell,
    paired,
    turned,
    view_of,
)
from pcretrieve.registration.matching import candidate_motions, distinct
from pcretrieve.types import FloatArray, PointCloud, Step, bounding_diagonal

__all__ = ["Merged", "Overlap", "merge_views"]

# Distances within which points are paired while poses are adjusted, step by step; reaches.
COARSE, FINE = (4.0, 4.0, 3.0, 3.0, 2.0, 2.0, 1.5, 1.0), (2.0, 1.5, 1.0, 1.0, 1.0, 0.7, 0.7, 0.5, 0.5, 0.5)
JOINING = (3.0, 2.0, 1.5, 1.0)

# Surfaces that meet this many times as loosely as those of the best match are different ones, unless they
# meet within this share of the reach. Smooth parts of different bodies, with residuals all over the reach,
# have 0.39 to 0.5 of it; views of one body 0.15 to 0.34, depending on noise.
LOOSE, TIGHT = 2.0, 0.25

# Views that are not together after one search are searched for once more, with other random tries.
ROUNDS = 2

# Pairs of views that share less than this share by chance; of the points of one of them.
LEAST_SHARE = 0.02

# Voxels touch where their numbers differ by one in each coordinate; corners by √3.
TOUCHING = 1.8


@dataclass(frozen=True, slots=True)
class Overlap:
    """Where two placed views show one surface.

    Attributes
    ----------
    first, second : int
        Numbers of the views, ``first < second``.
    share : float
        Points within reach of the other view's surface, of all points of the view that has more of them.
    rms : float
        Root mean square of their distance to its tangent planes; unit of the file.
    """

    first: int
    second: int
    share: float
    rms: float


@dataclass(frozen=True, slots=True, eq=False)
class Merged:
    """Views in one frame.

    Attributes
    ----------
    cloud : PointCloud
        The points of all placed views in the frame of the first of them, or of the given poses; with the
        sensor that saw each, or that was assumed to, and normals that face it.
    poses : (v, 4, 4) float64
        Rigid motion of each view into that frame; NaN for one that was left out.
    shares : (v,) float64
        Points of each view that another placed view saw too, of all its points; 0 for one that was left out.
    overlaps : tuple of Overlap
        Pairs of placed views that share a surface.
    scale : float
        Median diagonal of the views: what relative lengths refer to; unit of the file.
    """

    cloud: PointCloud
    poses: FloatArray
    shares: FloatArray
    overlaps: tuple[Overlap, ...]
    scale: float

    @property
    def left_out(self) -> tuple[int, ...]:
        """Numbers of the views that could not be placed."""
        return tuple(np.flatnonzero(np.isnan(self.poses[:, 0, 0])).tolist())

    def rms(self, view: int | None = None) -> float:
        """Of the overlaps of one view, or of all, weighted by their shares; NaN where there are none."""
        chosen = [pair for pair in self.overlaps if view in (None, pair.first, pair.second)]
        weight = sum(pair.share for pair in chosen)
        return float(np.sqrt(sum(pair.share * pair.rms**2 for pair in chosen) / weight)) if weight else np.nan


class _Verdict(NamedTuple):
    """What sensors say of two groups of views.

    Attributes
    ----------
    share : float
        Points of a view that the other group saw too, of all its points, in the view that has most of them.
    contradiction : float
        Points that the other group saw through, relative to those that it saw too.
    """

    share: float
    contradiction: float

    def holds(self, options: MergeOptions) -> bool:
        return self.share >= options.min_overlap and self.contradiction <= options.max_contradiction


class _Match(NamedTuple):
    """A motion from the frame of the second view of an overlap to that of the first."""

    overlap: Overlap
    motion: FloatArray  # (4, 4)

    @property
    def rank(self) -> tuple[float, int, int]:
        """Ascending from the best.

        A body's own symmetries make false matches that share much, and that no sensor contradicts; they meet
        less closely.
        """
        return -self.overlap.share / self.overlap.rms, self.overlap.first, self.overlap.second


def merge_views(
    views: Sequence[PointCloud],
    options: MergeOptions,
    *,
    poses: FloatArray | None = None,
    on_pair: Callable[[int, int], None] | None = None,
) -> Merged:
    """Bring range scans into one frame.

    Parameters
    ----------
    views : sequence of PointCloud, length v
        Each as one sensor saw it, in a frame of its own, all in one unit.
    options : MergeOptions
    poses : (v, 4, 4) float64, optional
        Rigid motions of the views into a common frame. They are refined (``options.refine``), and no view is
        left out. Without them each pose is searched for.
    on_pair : function, optional
        Told how many pairs of views have been matched, and of how many; those of different groups are matched
        once more.

    Returns
    -------
    Merged
        The same for the same views and options, to the last bit.

    Raises
    ------
    InputError
        If there are fewer than two views, poses are not one rigid motion for each, a view was seen by more
        than one sensor, or ``max_range`` is given without a sensor to measure from.
    ReconstructionError
        If a view has too few points, or no two views share a surface.
    """
    started = time.perf_counter()
    if len(views) < 2:
        raise InputError(f"merging needs at least two views, got {len(views)}")
    if poses is not None:
        _check_poses(poses, len(views))
    sensors = [_sensor(view, number, options) for number, view in enumerate(views)]
    fronts = [
        _foreground(view.points, sensor, number, options)
        for number, (view, sensor) in enumerate(zip(views, sensors, strict=True))
    ]
    scale = float(np.median([bounding_diagonal(points) for points in fronts]))
    reach = options.reach * scale
    rng = np.random.default_rng(options.seed)
    ready = [
        view_of(points, sensor, scale, options, rng) for points, sensor in zip(fronts, sensors, strict=True)
    ]
    if poses is None:
        placed = _largest_group(ready, scale, options, rng, on_pair)
    else:
        placed = dict(enumerate(np.array(poses, dtype=np.float64)))
        if options.refine:
            placed = _settled(ready, placed, (*COARSE, *FINE), reach)

    all_poses, shares, notes = np.full((len(views), 4, 4), np.nan), np.zeros(len(views)), []
    for number in range(len(views)):
        if number not in placed:
            notes.append(f"left out view {number}: it has no place where it shares a surface with the others")
            continue
        all_poses[number] = placed[number]
        others = {other: pose for other, pose in placed.items() if other != number}
        shares[number] = _seen_by(ready, {number: placed[number]}, others, reach)[0][0].mean()
        if shares[number] < options.min_overlap:
            notes.append(f"view {number} shares only {shares[number]:.1%} of its points with the others")
    cloud = _joined([ready[number].cloud for number in sorted(placed)], all_poses[sorted(placed)])
    cloud = cloud.select(one_of_each_cell(cloud.points, options.voxel * scale))
    sizes = {"views": float(len(views)), "placed": float(len(placed)), "points": float(len(cloud.points))}
    step = Step("merge", time.perf_counter() - started, sizes, tuple(notes))
    return Merged(cloud.after(step), all_poses, shares, _overlaps(ready, placed, reach), scale)


# --- views --------------------------------------------------------------------------------------------


def _check_poses(poses: FloatArray, n_views: int) -> None:
    if poses.shape != (n_views, 4, 4):
        raise InputError(f"poses must have shape ({n_views}, 4, 4), one for each view, got {poses.shape}")
    turns = poses[:, :3, :3]
    rigid = np.allclose(turns @ turns.transpose(0, 2, 1), np.eye(3), atol=1e-4)
    if not (rigid and (np.linalg.det(turns) > 0).all() and np.allclose(poses[:, 3], [0, 0, 0, 1])):
        raise InputError("poses must be rigid motions: a rotation, a translation, and a last row 0 0 0 1")


def _sensor(view: PointCloud, number: int, options: MergeOptions) -> FloatArray:
    """(3,) position of the sensor, assumed where the view names none."""
    if not len(view.points):
        raise ReconstructionError(f"view {number} has no points: leave it out", stage="merge")
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


def _foreground(points: FloatArray, sensor: FloatArray, number: int, options: MergeOptions) -> FloatArray:
    """(n, 3) points that are neither too far away nor apart from most others."""
    if options.max_range is not None:
        points = points[np.linalg.norm(points - sensor, axis=1) <= options.max_range]
    if options.keep_largest and len(points):
        points = points[_largest_piece(points, options.piece_gap * bounding_diagonal(points))]
    if len(points) <= NORMAL_NEIGHBORS or not bounding_diagonal(points):
        raise ReconstructionError(
            f"view {number} must have more than {NORMAL_NEIGHBORS} different points in reach, got "
            f"{len(points)}: leave it out, or raise max_range",
            stage="merge",
        )
    return points


def _largest_piece(points: FloatArray, gap: float) -> NDArray[np.bool_]:
    """(n,) whether a point is of the piece with the most points; pieces are chains of touching voxels."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    if not gap:
        return np.ones(len(points), dtype=bool)
    voxels, voxel = np.unique(np.floor(points / gap), axis=0, return_inverse=True)
    touching = cKDTree(voxels).query_pairs(TOUCHING, output_type="ndarray")  # (t, 2)
    graph = coo_array((np.ones(len(touching)), tuple(touching.T)), shape=(len(voxels), len(voxels)))
    piece = connected_components(graph, directed=False)[1][voxel.ravel()]  # (n,)
    return np.asarray(piece == np.bincount(piece).argmax())


def _joined(clouds: Sequence[PointCloud], poses: FloatArray) -> PointCloud:
    """All clouds in the common frame, one after another."""
    parts = [
        (moved(pose, cloud.points), turned(pose, cloud.normals), moved(pose, cloud.viewpoints))
        for cloud, pose in zip(clouds, poses, strict=True)
        if cloud.normals is not None and cloud.viewpoints is not None
    ]
    points, normals, viewpoints = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return PointCloud(points, normals, viewpoints)


# --- groups of views ----------------------------------------------------------------------------------


def _largest_group(
    views: Sequence[View],
    scale: float,
    options: MergeOptions,
    rng: np.random.Generator,
    on_pair: Callable[[int, int], None] | None,
) -> dict[int, FloatArray]:
    """Poses of the views that fit together, in the frame of the first of them."""
    reach = options.reach * scale
    groups = [{number: np.eye(4)} for number in range(len(views))]
    matches: list[_Match] = []
    n_done = 0
    for _ in range(ROUNDS):
        pairs = [
            (min(i, j), max(i, j)) for group, other in combinations(groups, 2) for i in group for j in other
        ]
        for left, (first, second) in zip(range(len(pairs) - 1, -1, -1), sorted(pairs), strict=True):
            matches += _matches(views, first, second, scale, options, rng)
            n_done += 1
            if on_pair is not None:
                on_pair(n_done, n_done + left)
        groups = _grouped(views, matches, groups, reach, options)
    largest = max(groups, key=len)
    if len(largest) == 1:
        raise ReconstructionError(
            f"no two of the {len(views)} views share a surface: scan with more overlap, or lower min_overlap",
            stage="merge",
        )
    settled = _settled(views, largest, FINE, reach)
    root = np.linalg.inv(settled[min(settled)])
    return {number: root @ pose for number, pose in settled.items()}


def _matches(
    views: Sequence[View],
    first: int,
    second: int,
    scale: float,
    options: MergeOptions,
    rng: np.random.Generator,
) -> list[_Match]:
    """Different motions of one view onto another that both sensors bear out."""
    found = []
    reach = options.reach * scale
    here = {first: np.eye(4)}
    for motion in candidate_motions(views[first], views[second], scale, options, rng):
        both = adjusted(
            views, here | {second: motion}, fixed=[first], reaches=np.multiply(COARSE, reach).tolist()
        )
        if _verdict(views, here, {second: both[second]}, reach).holds(options):
            found.append(_Match(_overlap(views, both, first, second, reach), both[second]))
    found.sort(key=lambda match: match.rank)
    motions = np.array([match.motion for match in found]).reshape(-1, 4, 4)
    kept = distinct(motions, views[second], options.cell * scale, most=len(found))
    return [found[number] for number in kept]


def _grouped(
    views: Sequence[View],
    matches: Sequence[_Match],
    groups: Sequence[dict[int, FloatArray]],
    reach: float,
    options: MergeOptions,
) -> list[dict[int, FloatArray]]:
    """The groups, joined where matches join them and all sensors bear it out.

    They grow from the best match on, so that one that deceives two views (a back that looks like a front)
    comes up against what many others saw.
    """
    joined = list(groups)
    ranked = sorted(matches, key=lambda match: match.rank)
    loosest = max(LOOSE * ranked[0].overlap.rms, TIGHT * reach) if ranked else 0.0
    for match in ranked:
        first, second = match.overlap.first, match.overlap.second
        group, other = (next(group for group in joined if number in group) for number in (first, second))
        if group is other or match.overlap.rms > loosest:
            continue
        motion = group[first] @ match.motion @ np.linalg.inv(other[second])
        both = group | {number: motion @ pose for number, pose in other.items()}
        both = adjusted(views, both, fixed=list(group), reaches=np.multiply(JOINING, reach).tolist())
        brought = {number: both[number] for number in other}
        if _verdict(views, group, brought, reach).holds(options):
            joined = [known for known in joined if known is not group and known is not other]
            joined.append(_settled(views, both, FINE[:4], reach))
    return joined


def _settled(
    views: Sequence[View], poses: Poses, reaches: Sequence[float], reach: float
) -> dict[int, FloatArray]:
    """The poses, all adjusted but that of the first."""
    return adjusted(views, poses, fixed=[min(poses)], reaches=np.multiply(reaches, reach).tolist())


def _verdict(views: Sequence[View], group: Poses, other: Poses, reach: float) -> _Verdict:
    said = _seen_by(views, group, other, reach) + _seen_by(views, other, group, reach)
    n_agreeing = sum(int(agrees.sum()) for agrees, _ in said)
    n_contradicting = sum(int(contradicts.sum()) for _, contradicts in said)
    share = max(float(agrees.mean()) for agrees, _ in said)
    return _Verdict(share, n_contradicting / n_agreeing if n_agreeing else np.inf)


def _seen_by(
    views: Sequence[View], group: Poses, other: Poses, reach: float
) -> list[tuple[NDArray[np.bool_], NDArray[np.bool_]]]:
    """For each view of a group: points of its sample that a sensor of the other saw, and saw through only."""
    answers = []
    for number, pose in group.items():
        view = views[number]
        agrees, contradicts = np.zeros((2, len(view.sample)), dtype=bool)
        for known, place in other.items():
            motion = np.linalg.inv(place) @ pose
            said = views[known].image.compare(
                moved(motion, view.points[view.sample]),
                turned(motion, view.normals[view.sample]),
                tolerance=reach,
            )
            agrees |= said.agrees
            contradicts |= said.contradicts
        answers.append((agrees, contradicts & ~agrees))
    return answers


def _overlap(views: Sequence[View], poses: Poses, first: int, second: int, reach: float) -> Overlap:
    """What two views share; a rms of NaN where that is nothing."""
    shares, distances = [], []
    for here, there in ((first, second), (second, first)):
        distance = paired(views[here], views[there], poses[here], poses[there], reach)[2]
        shares.append(len(distance) / len(views[there].sample))
        distances.append(distance)
    squares = np.concatenate(distances) ** 2
    return Overlap(first, second, max(shares), float(np.sqrt(squares.mean())) if len(squares) else np.nan)


def _overlaps(views: Sequence[View], poses: Poses, reach: float) -> tuple[Overlap, ...]:
    pairs = [_overlap(views, poses, *pair, reach) for pair in combinations(sorted(poses), 2)]
    return tuple(pair for pair in pairs if pair.share >= LEAST_SHARE)
