"""Registered views → how far they agree: overlaps of two views, and what range images say of two groups."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.options import MergeOptions
from pcretrieve.points.register.alignment import Poses, moved, paired, turned
from pcretrieve.points.register.views import View

# Smallest overlap of two views that is reported; fraction of the points of one of them.
LEAST_SHARE = 0.02


@dataclass(frozen=True, slots=True)
class Overlap:
    """The overlap of two registered views.

    rms: root mean square distance of the correspondences, point to plane; unit of the file.
    """

    first: int
    second: int
    share: float
    rms: float


class Verification(NamedTuple):
    """The verification of two groups of views by their range images."""

    share: float
    contradiction: float

    def holds(self, options: MergeOptions) -> bool:
        """Whether the groups fit each other, by `min_overlap` and `max_contradiction`."""
        return self.share >= options.min_overlap and self.contradiction <= options.max_contradiction


def verification(views: Sequence[View], group: Poses, other: Poses, reach: float) -> Verification:
    """Verify the poses of two groups of views by the range images of all of them.

    group, other: mapping of int to (4, 4) float64, the poses of the views of both groups in one frame, by
        number.
    reach: largest distance of points that agree; unit of the points.
    """
    said = _seen_by(views, group, other, reach) + _seen_by(views, other, group, reach)
    n_agreeing = sum(int(agrees.sum()) for agrees, _ in said)
    n_contradicting = sum(int(contradicts.sum()) for _, contradicts in said)
    share = max(float(agrees.mean()) for agrees, _ in said)
    return Verification(share, n_contradicting / n_agreeing if n_agreeing else np.inf)


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


def shared(views: Sequence[View], poses: Poses, number: int, reach: float) -> float:
    """The fraction of the points of a view that agree with the other views.

    poses: mapping of int to (4, 4) float64, the poses of the registered views, by number.
    reach: largest distance of points that agree; unit of the points.
    """
    others = {other: pose for other, pose in poses.items() if other != number}
    return float(_seen_by(views, {number: poses[number]}, others, reach)[0][0].mean())


def overlap(views: Sequence[View], poses: Poses, first: int, second: int, reach: float) -> Overlap:
    """The overlap of two views.

    poses: mapping of int to (4, 4) float64, the poses of the registered views, by number.
    reach: largest distance of correspondences; unit of the points.
    """
    shares, distances = [], []
    for here, there in ((first, second), (second, first)):
        distance = paired(views[here], views[there], poses[here], poses[there], reach)[2]
        shares.append(len(distance) / len(views[there].sample))
        distances.append(distance)
    squares = np.concatenate(distances) ** 2
    return Overlap(first, second, max(shares), float(np.sqrt(squares.mean())) if len(squares) else np.nan)


def overlaps(
    views: Sequence[View], poses: Poses, pairs: Iterable[tuple[int, int]], reach: float
) -> tuple[Overlap, ...]:
    """The overlaps of the pairs of registered views that share at least `LEAST_SHARE`.

    poses: mapping of int to (4, 4) float64, the poses of the registered views, by number.
    reach: largest distance of correspondences; unit of the points.
    """
    ordered = sorted((min(pair), max(pair)) for pair in pairs)
    found = [overlap(views, poses, first, second, reach) for first, second in ordered]
    return tuple(pair for pair in found if pair.share >= LEAST_SHARE)
