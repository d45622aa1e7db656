"""Global registration: range scans (views) with unknown poses → one cloud.

All pairs of views are matched. Groups of views are merged in the order of the quality of the matches; a merge
is accepted only if the range images of all views agree with it: no view may have points in space that another
view observed as empty. Views outside the largest group are left out, with a note in the provenance.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import InputError, ReconstructionError, Stage
from pcretrieve.formats.conf import SENSOR_DISTANCE
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

# Largest distances of correspondences in the steps of a refinement, in units of the option `reach`: of a
# match, of the final poses, and of two groups.
COARSE, FINE = (4.0, 4.0, 3.0, 3.0, 2.0, 2.0, 1.5, 1.0), (2.0, 1.5, 1.0, 1.0, 1.0, 0.7, 0.7, 0.5, 0.5, 0.5)
JOINING = (3.0, 2.0, 1.5, 1.0)

# A match is rejected if its root mean square distance is more than LOOSE times that of the best match, and
# more than TIGHT times the option `reach`. See docs/decisions.md, LOOSE.
LOOSE, TIGHT = 2.0, 0.25

# Number of searches. Views that are not in one group after the first are matched
# again, with other random samples.
ROUNDS = 2

# Smallest overlap of two views that is reported; fraction of the points of one of them.
LEAST_SHARE = 0.02

# Voxels are 26-adjacent if their indices are less than this apart: √3 < 1.8 < 2.
TOUCHING = 1.8


@dataclass(frozen=True, slots=True)
class Overlap:
    """The overlap of two registered views.

    Attributes
    ----------
    first, second : int
        Numbers of the views, ``first < second``.
    share : float
        Fraction of the points of one view with a correspondence in the other, for
        the view with the larger one.
    rms : float
        Root mean square distance of the correspondences, point to plane; unit of the file.
    """

    first: int
    second: int
    share: float
    rms: float


@dataclass(frozen=True, slots=True, eq=False)
class Merged:
    """Registered views.

    Attributes
    ----------
    cloud : PointCloud
        The points of all registered views, in the frame of the first of them, or of the given poses; with
        normals towards the sensors, and the position of the sensor of each point.
    poses : (v, 4, 4) float64
        Rigid motion of each view into this frame; NaN if the view was left out.
    shares : (v,) float64
        Fraction of the points of each view that another registered view measured too; 0 if it was left out.
    overlaps : tuple of Overlap
        The overlaps of pairs of registered views.
    scale : float
        Median diagonal of the views, to which relative options refer; unit of the file.
    """

    cloud: PointCloud
    poses: FloatArray
    shares: FloatArray
    overlaps: tuple[Overlap, ...]
    scale: float

    @property
    def left_out(self) -> tuple[int, ...]:
        """Numbers of the views that could not be registered."""
        return tuple(np.flatnonzero(np.isnan(self.poses[:, 0, 0])).tolist())

    def rms(self, view: int | None = None) -> float:
        """The root mean square distance of overlaps, weighted by their shares.

        Parameters
        ----------
        view : int or None, default None
            Number of a view, for its overlaps only. None: all overlaps.

        Returns
        -------
        float
            Unit of the file; NaN if there is no overlap.
        """
        chosen = [pair for pair in self.overlaps if view in (None, pair.first, pair.second)]
        weight = sum(pair.share for pair in chosen)
        return float(np.sqrt(sum(pair.share * pair.rms**2 for pair in chosen) / weight)) if weight else np.nan


class _Verdict(NamedTuple):
    """The verification of two groups of views by their range images.

    Attributes
    ----------
    share : float
        Fraction of the points of a view that agree with the other group, for the view with the largest one.
    contradiction : float
        Number of points that contradict the other group, relative to the number of those that agree.
    """

    share: float
    contradiction: float

    def holds(self, options: MergeOptions) -> bool:
        return self.share >= options.min_overlap and self.contradiction <= options.max_contradiction


class _Match(NamedTuple):
    """A verified motion from the frame of the second view of an overlap to that of the first."""

    overlap: Overlap
    motion: FloatArray  # (4, 4)

    @property
    def rank(self) -> tuple[float, int, int]:
        """A sort key, ascending from the best match: by the overlap divided by its residual.

        Symmetries of a body cause false matches with a large overlap and without contradictions, but with a
        larger residual than true matches.
        """
        return -self.overlap.share / self.overlap.rms, self.overlap.first, self.overlap.second


def merge_views(
    views: Sequence[PointCloud],
    options: MergeOptions,
    *,
    poses: FloatArray | None = None,
    on_pair: Callable[[int, int], None] | None = None,
) -> Merged:
    """Register range scans, and merge them into one cloud.

    Parameters
    ----------
    views : sequence of PointCloud, length v
        The points that one sensor measured from one position, each view in a frame
        of its own; all in one unit.
    options : MergeOptions
        The parameters of the registration.
    poses : (v, 4, 4) float64, optional
        Rigid motions of the views into a common frame. They are refined if ``options.refine`` is set, and no
        view is left out. Without them all poses are searched.
    on_pair : function, optional
        Called with the number of pairs of views that have been matched, and the number of all pairs. Pairs of
        views in different groups are matched twice.

    Returns
    -------
    Merged
        The merged cloud and the poses. Equal views and options give equal results, bit for bit.

    Raises
    ------
    InputError
        If there are fewer than two views, the poses are not one rigid motion for each view, a view has more
        than one sensor position, or ``max_range`` is given and the position of the sensor is not known.
    ReconstructionError
        If a view has too few points, or no two views overlap.
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


def _foreground(points: FloatArray, sensor: FloatArray, number: int, options: MergeOptions) -> FloatArray:
    """(n, 3) points within `max_range`, and of the largest component, if these options are set."""
    if options.max_range is not None:
        points = points[np.linalg.norm(points - sensor, axis=1) <= options.max_range]
    if options.keep_largest and len(points):
        points = points[_largest_piece(points, options.piece_gap * bounding_diagonal(points))]
    if len(points) <= NORMAL_NEIGHBORS or not bounding_diagonal(points):
        raise ReconstructionError(
            f"view {number} must have more than {NORMAL_NEIGHBORS} different points in reach, got "
            f"{len(points)}: leave it out, or raise max_range",
            stage=Stage.MERGE,
        )
    return points


def _largest_piece(points: FloatArray, gap: float) -> NDArray[np.bool_]:
    """(n,) mask of the component with the most points, by 26-connected voxels of the edge `gap`."""
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
    """The concatenation of all clouds, in the common frame."""
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
    """Poses of the views of the largest group, in the frame of the first of them."""
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
            stage=Stage.MERGE,
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
    """Distinct, refined motions of one view onto another that the range images of both verify."""
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
    """Groups of views, after merging groups by their matches, if the range images of all views verify it."""
    # In the order of the quality of the matches: a false match, such as of a back with a front, can be
    # verified by the two views alone, but is contradicted by the other views of larger groups.
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
    """The poses after refinement of all of them except the first."""
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
    """For each view of a group, masks of points that agree with the other group and that contradict it."""
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
    """The overlap of two views; its rms is NaN, if there are no correspondences."""
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
