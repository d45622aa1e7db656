"""Views without poses → the largest group of them that fit each other.

All pairs of views are matched. Groups of views are merged in the order of the quality of the matches; a merge
is accepted only if the range images of all views agree with it: no view may have points in space that another
view observed as empty.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from pcretrieve.errors import ReconstructionError, Stage
from pcretrieve.options import MergeOptions
from pcretrieve.points.register.agreement import Overlap, overlap, verification
from pcretrieve.points.register.alignment import adjusted
from pcretrieve.points.register.matching import candidate_motions, distinct
from pcretrieve.points.register.motions import Poses
from pcretrieve.points.register.views import View, features_of
from pcretrieve.values import FloatArray

__all__ = ["COARSE", "FINE", "largest_group", "settled"]

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


def largest_group(
    views: Sequence[View],
    groups: Sequence[Poses],
    scale: float,
    options: MergeOptions,
    rng: np.random.Generator,
    on_pair: Callable[[int, int], None] | None,
) -> dict[int, FloatArray]:
    """Match all pairs of views of different groups, and merge the groups that fit each other.

    groups: sequence of mappings of int to (4, 4) float64, the poses of the views that are registered to each
        other already, by number; of a view alone, any.
    scale: the length to which relative options refer; unit of the points.
    Returns dict of int to (4, 4) float64: poses of the views of the largest group, by number, in the frame of
        the first of them.
    """
    reach = options.reach * scale
    joined = [dict(group) for group in groups]
    matches: list[_Match] = []
    features: dict[int, FloatArray] = {}
    n_done = 0
    for _ in range(ROUNDS):
        pairs = [
            (min(i, j), max(i, j)) for group, other in combinations(joined, 2) for i in group for j in other
        ]
        for left, (first, second) in zip(range(len(pairs) - 1, -1, -1), sorted(pairs), strict=True):
            for number in (first, second):
                if number not in features:
                    features[number] = features_of(views[number], options.cell * scale)
            pair = features[first], features[second]
            matches += _matches(views, first, second, pair, scale, options, rng)
            n_done += 1
            if on_pair is not None:
                on_pair(n_done, n_done + left)
        joined = _grouped(views, matches, joined, reach, options)
    largest = max(joined, key=len)
    if len(largest) == 1:
        raise ReconstructionError(
            f"no two of the {len(views)} views share a surface: scan with more overlap, or lower min_overlap",
            stage=Stage.MERGE,
        )
    poses = settled(views, largest, FINE, reach)
    root = np.linalg.inv(poses[min(poses)])
    return {number: root @ pose for number, pose in poses.items()}


def _matches(
    views: Sequence[View],
    first: int,
    second: int,
    features: tuple[FloatArray, FloatArray],
    scale: float,
    options: MergeOptions,
    rng: np.random.Generator,
) -> list[_Match]:
    """Distinct, refined motions of one view onto another that the range images of both verify."""
    found = []
    reach = options.reach * scale
    here = {first: np.eye(4)}
    for motion in candidate_motions(views[first], views[second], features, scale, options, rng):
        both = adjusted(
            views, here | {second: motion}, fixed=[first], reaches=np.multiply(COARSE, reach).tolist()
        )
        if verification(views, here, {second: both[second]}, reach).holds(options):
            found.append(_Match(overlap(views, both, first, second, reach), both[second]))
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
        if verification(views, group, brought, reach).holds(options):
            joined = [known for known in joined if known is not group and known is not other]
            joined.append(settled(views, both, FINE[:4], reach))
    return joined


def settled(
    views: Sequence[View], poses: Poses, reaches: Sequence[float], reach: float
) -> dict[int, FloatArray]:
    """Refine the poses of all views except the first.

    poses: mapping of int to (4, 4) float64, the poses of the views of one group, by number.
    reaches: largest distance of correspondences in each step, in units of `reach`, such as `FINE`.
    Returns dict of int to (4, 4) float64: the refined poses.
    """
    return adjusted(views, poses, fixed=[min(poses)], reaches=np.multiply(reaches, reach).tolist())
