"""Views → groups that fit each other, by feature matching, random sampling and verified motions."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.arrays import DOUBLE_OFFSET, Frame, unit_vectors
from pcretrieve.arrays.open3d import library, open3d_cloud
from pcretrieve.errors import ReconstructionError, Stage
from pcretrieve.options import MergeOptions
from pcretrieve.pipeline.registration.alignment import (
    Overlap,
    Poses,
    adjusted,
    moved,
    overlap,
    turned,
    verification,
)
from pcretrieve.pipeline.registration.views import View
from pcretrieve.values import FloatArray

# Radius of the neighbourhood of a feature, in voxels. It is of the size of distinctive parts of a body.
FEATURE_RADIUS = 6

# Number of points of a view, those with the most distinctive features, that are matched with another view,
# and number of matches of each point.
KEY_POINTS = 1500
LOOK_ALIKES = 4

# Smallest distance of two points that determine a motion, in voxels; and the largest differences of two
# corresponding pairs of points: of their distances, in voxels, and of the cosines between their line and
# their normals.
SHORTEST_PAIR = 10
PAIR_LENGTH = 1.5
PAIR_COSINE = 0.2

# Number of motions that are scored, and number of points of each view for the score.
MOST_MOTIONS = 1500
FEW_POINTS = 200

# Tolerance of the score, in units of `reach`; larger than 1, because the candidates are approximate.
ROUGH = 2

# Largest difference of two motions that are refined to the same motion: cosine of the angle (25 degrees), and
# distance in voxels.
SAME_COSINE = 0.906
SAME_CELLS = 10


def feature_histograms(
    points: FloatArray, normals: FloatArray, *, radius: float
) -> FloatArray:
    """(k, 33) fast point feature histograms (FPFH) [1]_ of oriented points, invariant to rigid motion.

    References
    ----------
    .. [1] Rusu et al., "Fast point feature histograms (FPFH) for 3D registration", ICRA 2009.
    """
    o3d = library()
    frame = Frame.around(points, offset=DOUBLE_OFFSET)
    search = o3d.geometry.KDTreeSearchParamRadius(radius / frame.size)
    cloud = open3d_cloud(frame.inward(points), normals)
    return np.array(o3d.pipelines.registration.compute_fpfh_feature(cloud, search).data.T)


def _candidates(
    views: tuple[View, View],
    features: tuple[FloatArray, FloatArray],
    cell: float,
    reach: float,
    options: MergeOptions,
    rng: np.random.Generator,
) -> FloatArray:
    """Candidates of the motion of the second view into the frame of the first: (m, 4, 4), the best first.

    Two oriented points determine a rigid motion. Random pairs of points of one view are matched with pairs of
    points of the other view that have similar features, equal distances and equal angles between their
    normals. The resulting motions are scored by the range images of both views: by the points that agree,
    minus the points that contradict.
    """
    first, second = views
    here, there = _look_alikes(*features)
    one, two = rng.integers(len(here), size=(2, options.n_tries))
    pairs, others = (
        _pairs(first, here[one], here[two]),
        _pairs(second, there[one], there[two]),
    )
    unlike = _unlike(pairs, others, cell)  # (n_tries,)
    chosen = np.argsort(unlike, kind="stable")[
        : min(MOST_MOTIONS, int((unlike < 1).sum()))
    ]

    motions: FloatArray = np.tile(np.eye(4), (len(chosen), 1, 1))
    motions[:, :3, :3] = pairs.frame[chosen] @ others.frame[chosen].transpose(0, 2, 1)
    motions[:, :3, 3] = pairs.middle[chosen] - np.einsum(
        "mij,mj->mi", motions[:, :3, :3], others.middle[chosen]
    )
    score = _scores(first, second, motions, ROUGH * reach)
    score += _scores(
        second, first, np.linalg.inv(motions).astype(np.float64), ROUGH * reach
    )
    order = np.argsort(-score, kind="stable")
    best = motions[order[score[order] > 0]]
    return best[_distinct(best, second, cell, most=options.n_candidates)]


def _distinct(motions: FloatArray, view: View, cell: float, *, most: int) -> list[int]:
    """Select distinct motions of a view from (m, 4, 4) motions, the best first."""
    kept: list[int] = []
    middles = moved(motions, view.points.mean(axis=0, keepdims=True))[:, 0]  # (m, 3)
    for number, motion in enumerate(motions):
        if len(kept) == most:
            break
        cosine = (np.einsum("mij,ij->m", motions[kept, :3, :3], motion[:3, :3]) - 1) / 2
        apart = np.linalg.norm(middles[kept] - middles[number], axis=1)
        if not ((cosine > SAME_COSINE) & (apart < SAME_CELLS * cell)).any():
            kept.append(number)
    return kept


def _look_alikes(
    first: FloatArray, second: FloatArray
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """(l,) and (l,) positions of points of two views with similar features."""
    usual = np.concatenate([first, second]).mean(axis=0)
    alike = []
    for features, others in ((first, second), (second, first)):
        # Features near the mean, such as those of a plane, are not distinctive.
        keys = np.argsort(-np.linalg.norm(features - usual, axis=1), kind="stable")[
            :KEY_POINTS
        ]
        # Squared, minus a constant.
        distance = (others**2).sum(axis=1) - 2 * features[keys] @ others.T
        n = min(LOOK_ALIKES, len(others))
        alike.append(
            (np.repeat(keys, n), np.argpartition(distance, n - 1, axis=1)[:, :n].ravel())
        )
    (here, there), (back, forth) = alike
    return np.concatenate([here, forth]), np.concatenate([there, back])


class Pairs(NamedTuple):
    """The lengths (n,), cosines (n, 3), frames (n, 3, 3) and midpoints (n, 3) of pairs of oriented points.

    The cosines are those between the line and both normals, and between the normals.
    """

    length: FloatArray
    cosines: FloatArray
    frame: FloatArray
    middle: FloatArray


def _unlike(pairs: Pairs, others: Pairs, cell: float) -> FloatArray:
    """(n,) dissimilarities of pairs of one view and of the other; 1 is the largest that is accepted."""
    unlike = np.maximum(
        np.abs(pairs.length - others.length) / (PAIR_LENGTH * cell),
        np.abs(pairs.cosines - others.cosines).max(axis=1) / PAIR_COSINE,
    )
    unlike[np.minimum(pairs.length, others.length) < SHORTEST_PAIR * cell] = np.inf
    return np.asarray(unlike)


def _pairs(view: View, one: NDArray[np.intp], two: NDArray[np.intp]) -> Pairs:
    line = view.points[two] - view.points[one]
    length: FloatArray = np.linalg.norm(line, axis=1)
    line /= np.maximum(length, np.finfo(float).tiny)[:, None]
    start, end = (np.einsum("ij,ij->i", view.normals[ends], line) for ends in (one, two))
    between = np.einsum("ij,ij->i", view.normals[one], view.normals[two])
    up = unit_vectors(
        view.normals[one] + view.normals[two] - (start + end)[:, None] * line
    )
    frame = np.stack([line, up, np.cross(line, up)], axis=2)
    cosines = np.stack([start, end, between], axis=1)
    return Pairs(length, cosines, frame, (view.points[one] + view.points[two]) / 2)


def _scores(
    first: View, second: View, motions: FloatArray, tolerance: float
) -> FloatArray:
    """(m,) fraction of points of `second` that agree with the image of `first`, minus contradictions."""
    few = second.sample[:FEW_POINTS]
    points, normals = (
        moved(motions, second.points[few]),
        turned(motions, second.normals[few]),
    )
    said = first.image.compare(points, normals, tolerance=tolerance)
    return np.asarray(said.agrees.mean(axis=1) - said.contradicts.mean(axis=1))


# Largest distances of correspondences in the steps of a refinement, in units of `reach`: of a match, of the
# final poses, and of two groups.
COARSE = (4.0, 4.0, 3.0, 3.0, 2.0, 2.0, 1.5, 1.0)
FINE = (2.0, 1.5, 1.0, 1.0, 1.0, 0.7, 0.7, 0.5, 0.5, 0.5)
JOINING = (3.0, 2.0, 1.5, 1.0)

# A match is rejected if its root mean square distance is more than LOOSE times that of the best match, and
# more than TIGHT times `reach`.
LOOSE = 2.0
TIGHT = 0.25

# Number of searches. Views that are not in one group after the first are matched again, with other random
# samples.
ROUNDS = 2


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
        return (
            -self.overlap.share / self.overlap.rms,
            self.overlap.first,
            self.overlap.second,
        )


def largest_group(
    views: Sequence[View],
    groups: Sequence[Poses],
    cell: float,
    reach: float,
    options: MergeOptions,
    rng: np.random.Generator,
) -> dict[int, FloatArray]:
    """Match all pairs of views of different groups, and merge the groups that fit each other.

    groups: the poses of the views that are registered to each other already; of a view alone, any.
    Returns dict of int to (4, 4) float64: poses of the views of the largest group, by number, in the frame of
        the first of them.
    """
    joined = [dict(group) for group in groups]
    matches: list[_Match] = []
    features: dict[int, FloatArray] = {}
    for _ in range(ROUNDS):
        pairs = sorted(
            (min(i, j), max(i, j))
            for group, other in combinations(joined, 2)
            for i in group
            for j in other
        )
        for first, second in pairs:
            for number in (first, second):
                if number not in features:
                    points, normals = views[number].points, views[number].normals
                    features[number] = feature_histograms(
                        points, normals, radius=FEATURE_RADIUS * cell
                    )
            motions = _candidates(
                (views[first], views[second]),
                (features[first], features[second]),
                cell,
                reach,
                options,
                rng,
            )
            matches += _matches(views, first, second, motions, cell, reach, options)
        joined = _grouped(views, matches, joined, reach, options)
    largest = max(joined, key=len)
    if len(largest) == 1:
        raise ReconstructionError(
            f"no two of the {len(views)} views share a surface: scan with more overlap, or lower min_overlap",
            stage=Stage.MERGE,
        )
    poses = adjusted(views, largest, fixed=[min(largest)], steps=FINE, reach=reach)
    root = np.linalg.inv(poses[min(poses)])
    return {number: root @ pose for number, pose in poses.items()}


def _matches(
    views: Sequence[View],
    first: int,
    second: int,
    motions: FloatArray,
    cell: float,
    reach: float,
    options: MergeOptions,
) -> list[_Match]:
    """Distinct, refined motions of one view onto another that the range images of both verify."""
    found = []
    here = {first: np.eye(4)}
    for motion in motions:
        both = adjusted(
            views, here | {second: motion}, fixed=[first], steps=COARSE, reach=reach
        )
        if verification(views, here, {second: both[second]}, reach).holds(options):
            found.append(_Match(overlap(views, both, first, second, reach), both[second]))
    found.sort(key=lambda match: match.rank)
    refined = np.array([match.motion for match in found]).reshape(-1, 4, 4)
    return [
        found[number]
        for number in _distinct(refined, views[second], cell, most=len(found))
    ]


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
        group, other = (
            next(group for group in joined if number in group)
            for number in (first, second)
        )
        if group is other or match.overlap.rms > loosest:
            continue
        motion = group[first] @ match.motion @ np.linalg.inv(other[second])
        both = group | {number: motion @ pose for number, pose in other.items()}
        both = adjusted(views, both, fixed=list(group), steps=JOINING, reach=reach)
        if verification(
            views, group, {number: both[number] for number in other}, reach
        ).holds(options):
            joined = [
                known for known in joined if known is not group and known is not other
            ]
            joined.append(
                adjusted(views, both, fixed=[min(both)], steps=FINE[:4], reach=reach)
            )
    return joined
