"""Views and their poses → refined poses, and how far the views agree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pcretrieve.options import MergeOptions
from pcretrieve.pipeline.registration.views import LEAST_COSINE, View
from pcretrieve.values import FloatArray

#: Rigid motions, (4, 4) float64, of views into a common frame, by the number of the view.
Poses: TypeAlias = Mapping[int, FloatArray]


def moved(motion: FloatArray, points: FloatArray) -> FloatArray:
    """(n, 3) points after a rigid motion (4, 4); (m, n, 3) after each of (m, 4, 4) motions."""
    return turned(motion, points) + motion[..., None, :3, 3]


def turned(motion: FloatArray, directions: FloatArray) -> FloatArray:
    """(n, 3) directions after the rotation of a motion (4, 4); (m, n, 3) after each of (m, 4, 4)."""
    return directions @ np.swapaxes(motion[..., :3, :3], -1, -2)


# Largest distance, in spacings, of the nearest point from the foot of the perpendicular to its tangent plane.
BESIDE = 2

# Degrees of freedom of a rigid motion, and smallest number of correspondences between two views.
FREEDOMS = 6


def _paired(
    first: View,
    second: View,
    first_pose: FloatArray,
    second_pose: FloatArray,
    reach: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Point-to-plane correspondences of two views: nearest neighbours with similar normals.

    reach: largest distance between a point and the tangent plane of its nearest neighbour.
    Returns points, planes : (p, 3) float64: points of the sample of `second`, and unit normals of their
        nearest neighbours in `first`, in the common frame.
    Returns distance : (p,) float64: from the tangent planes, positive on the side of the normal.
    """
    # From the frame of `second` to that of `first`.
    motion = np.linalg.inv(first_pose) @ second_pose
    points = moved(motion, second.points[second.sample])
    normals = turned(motion, second.normals[second.sample])
    # Near the boundary of a view, and between its points, the nearest point is not at the foot of the
    # perpendicular.
    bound = np.hypot(reach, BESIDE * first.spacing)
    nearest = np.asarray(first.tree.query(points, distance_upper_bound=bound)[1])
    near = nearest < len(first.cloud.points)
    points, normals, nearest = points[near], normals[near], nearest[near]
    planes = np.asarray(first.cloud.normals)[nearest]
    distance = np.einsum("ij,ij->i", points - first.feet[nearest], planes)
    kept = (np.abs(distance) < reach) & (
        np.einsum("ij,ij->i", normals, planes) > LEAST_COSINE
    )
    return (
        moved(first_pose, points[kept]),
        turned(first_pose, planes[kept]),
        distance[kept],
    )


def adjusted(
    views: Sequence[View],
    poses: Poses,
    *,
    fixed: Sequence[int],
    steps: Sequence[float],
    reach: float,
) -> dict[int, FloatArray]:
    """Refine the poses of several views simultaneously, by point-to-plane ICP [1]_ [2]_.

    Each step minimises the distances of points from the tangent planes of their nearest neighbours in all
    other views, by Gauss–Newton. All pairs of views are used in one system, so that errors do not accumulate
    around the body. The twist (ω, v) of a view moves its points by ω × x + v. The distance n · (x_j − x_i)
    therefore has the gradient g = (x × n, n) with respect to the twist of view j, and −g with respect to that
    of view i.

    steps: largest distance of correspondences in each step, in units of `reach`.

    References
    ----------
    .. [1] Y. Chen and G. Medioni, "Object modelling by registration of multiple range images", Image and
       Vision Computing 10 (1992).
    .. [2] K. Pulli, "Multiview registration for large data sets", 3DIM 1999.
    """
    changed = dict(poses)
    free = [number for number in poses if number not in fixed]
    column = {number: slice(6 * k, 6 * k + 6) for k, number in enumerate(free)}
    pairs = [
        (i, j) for i in poses for j in poses if i != j and (i in column or j in column)
    ]
    for step in steps:
        changed = _stepped(views, changed, pairs, column, step * reach)
    return changed


def _stepped(
    views: Sequence[View],
    poses: Poses,
    pairs: Sequence[tuple[int, int]],
    column: Mapping[int, slice],
    farthest: float,
) -> dict[int, FloatArray]:
    """The poses after one step, in which views with a place in the system of equations (`column`) move."""
    matrix, right = (
        np.zeros((6 * len(column), 6 * len(column))),
        np.zeros(6 * len(column)),
    )
    centres = [
        moved(poses[number], views[number].points).mean(axis=0) for number in poses
    ]
    middle = np.array(centres).mean(axis=0)
    for i, j in pairs:
        paired = _paired(views[i], views[j], poses[i], poses[j], farthest)
        if len(paired[0]) < FREEDOMS:
            continue
        block, pull = _equations(*paired, middle, farthest)
        for number, sign in ((i, 1), (j, -1)):
            if number in column:
                matrix[column[number], column[number]] += block
                right[column[number]] += sign * pull
        if i in column and j in column:
            matrix[column[i], column[j]] -= block
            matrix[column[j], column[i]] -= block
    # The minimum-norm solution: undetermined motions, such as a slide along a plane, are zero.
    twist = np.linalg.lstsq(matrix, right, rcond=1e-9)[0].astype(np.float64)
    moves = {
        number: _motion(twist[at], middle, farthest) for number, at in column.items()
    }
    return {
        number: moves[number] @ pose if number in moves else pose
        for number, pose in poses.items()
    }


def _equations(
    points: FloatArray,
    planes: FloatArray,
    distance: FloatArray,
    middle: FloatArray,
    farthest: float,
) -> tuple[FloatArray, FloatArray]:
    """Σ w g gᵀ (6, 6) and Σ w d g (6,) over pairs of a point and a plane at the distance d."""
    # Tukey's biweight, which is zero at the largest distance: the cost is continuous.
    weight = (1 - (distance / farthest) ** 2) ** 2
    arm = (points - middle) / farthest  # scaled, so that ω and v have the same unit
    gradient = np.concatenate([np.cross(arm, planes), planes], axis=1)  # (p, 6)
    return gradient.T @ (weight[:, None] * gradient), gradient.T @ (weight * distance)


def _motion(twist: FloatArray, middle: FloatArray, length: float) -> FloatArray:
    """The (4, 4) rigid motion of a twist (ω · length, v) about the point `middle`."""
    from scipy.spatial.transform import Rotation

    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_rotvec(twist[:3] / length).as_matrix()
    motion[:3, 3] = middle + twist[3:] - motion[:3, :3] @ middle
    return motion


class Verification(NamedTuple):
    """What the range images of two groups of views say of each other.

    contradiction: number of points in space observed as empty, relative to the number of points that agree.
    """

    share: float
    contradiction: float

    def holds(self, options: MergeOptions) -> bool:
        """Whether the groups fit each other."""
        return (
            self.share >= options.min_overlap
            and self.contradiction <= options.max_contradiction
        )


def verification(
    views: Sequence[View], group: Poses, other: Poses, reach: float
) -> Verification:
    """Verify the poses of two groups of views, in one frame, by the range images of all of them."""
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
            points, normals = view.points[view.sample], view.normals[view.sample]
            said = views[known].image.compare(
                moved(motion, points), turned(motion, normals), tolerance=reach
            )
            agrees |= said.agrees
            contradicts |= said.contradicts
        answers.append((agrees, contradicts & ~agrees))
    return answers


def shared(views: Sequence[View], poses: Poses, number: int, reach: float) -> float:
    """The fraction of the points of a view that agree with the other views."""
    others = {other: pose for other, pose in poses.items() if other != number}
    return float(_seen_by(views, {number: poses[number]}, others, reach)[0][0].mean())


# Smallest noise with which the distance of two views is compared, in units of `reach`: 1 mm of a person.
LEAST_NOISE = 0.05


@dataclass(frozen=True, slots=True)
class Overlap:
    """The overlap of two registered views.

    share: fraction of the points of one of them.
    rms: root mean square distance of the correspondences, point to plane; unit of the file.
    apart: median distance of the correspondences; about the noise of the views, if they fit.
    noise: median distance of the points of the noisier view from the planes of their neighbours.
    """

    first: int
    second: int
    share: float
    rms: float
    apart: float
    noise: float


def overlap(
    views: Sequence[View], poses: Poses, first: int, second: int, reach: float
) -> Overlap:
    """The overlap of two views, with correspondences up to the distance `reach`."""
    shares, distances = [], []
    for here, there in ((first, second), (second, first)):
        distance = _paired(views[here], views[there], poses[here], poses[there], reach)[2]
        shares.append(len(distance) / len(views[there].sample))
        distances.append(distance)
    found = np.abs(np.concatenate(distances))
    rms, apart = np.nan, np.nan
    if len(found):
        rms, apart = float(np.sqrt((found**2).mean())), float(np.median(found))
    noise = max(views[first].noise, views[second].noise, LEAST_NOISE * reach)
    return Overlap(first, second, max(shares), rms, apart, noise)
