"""Rigid motions of points and directions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np

from pcretrieve.points.register.range_image import LEAST_COSINE
from pcretrieve.points.register.views import View
from pcretrieve.values import FloatArray

#: Rigid motions, (4, 4) float64, of views into a common frame, by the number of the view.
Poses: TypeAlias = Mapping[int, FloatArray]


def moved(motion: FloatArray, points: FloatArray) -> FloatArray:
    """Apply rigid motions to points.

    motion: (4, 4) or (m, 4, 4) float64, one motion, or m motions.
    points: (n, 3) float64, coordinates.
    Returns (n, 3) or (m, n, 3) float64: coordinates after the motion, or after each motion.
    """
    return np.asarray(turned(motion, points) + motion[..., None, :3, 3])


def turned(motion: FloatArray, directions: FloatArray) -> FloatArray:
    """Apply the rotations of rigid motions to directions.

    motion: (4, 4) or (m, 4, 4) float64, one motion, or m motions.
    directions: (n, 3) float64, vectors.
    Returns (n, 3) or (m, n, 3) float64: vectors after the rotation, or after each rotation.
    """
    return np.asarray(directions @ np.swapaxes(motion[..., :3, :3], -1, -2))


# Largest distance, in spacings, of the nearest point from the foot of the perpendicular to its tangent plane.
BESIDE = 2

# Degrees of freedom of a rigid motion, and smallest number of correspondences between two views.
FREEDOMS = 6


def paired(
    first: View, second: View, first_pose: FloatArray, second_pose: FloatArray, reach: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Point-to-plane correspondences of two views: nearest neighbours with similar normals.

    first_pose, second_pose: (4, 4) float64, their poses in the common frame.
    reach: largest distance between a point and the tangent plane of its nearest neighbour; unit of the
        points.
    Returns points : (p, 3) float64: points of the sample of `second`, in the common frame.
    Returns planes : (p, 3) float64: unit normals of their nearest neighbours in `first`, in the common frame.
    Returns distance : (p,) float64: signed distances from the tangent planes, positive on the side of the
        normal; unit of the points.
    """
    motion = np.linalg.inv(first_pose) @ second_pose  # from the frame of `second` to that of `first`
    points = moved(motion, second.points[second.sample])
    normals = turned(motion, second.normals[second.sample])
    # Near the boundary of a view, and between its points, the nearest point is not
    # at the foot of the perpendicular.
    bound = np.hypot(reach, BESIDE * first.spacing)
    nearest = np.asarray(first.tree.query(points, distance_upper_bound=bound)[1])
    near = nearest < len(first.cloud.points)
    points, normals, nearest = points[near], normals[near], nearest[near]
    planes = np.asarray(first.cloud.normals)[nearest]
    distance = np.einsum("ij,ij->i", points - first.feet[nearest], planes)
    kept = (np.abs(distance) < reach) & (np.einsum("ij,ij->i", normals, planes) > LEAST_COSINE)
    return moved(first_pose, points[kept]), turned(first_pose, planes[kept]), distance[kept]


def adjusted(
    views: Sequence[View], poses: Poses, *, fixed: Sequence[int], reaches: Sequence[float]
) -> dict[int, FloatArray]:
    """Refine the poses of several views simultaneously, by point-to-plane ICP [1]_ [2]_.

    Each step minimises the distances of points from the tangent planes of their nearest
    neighbours in all other views, by Gauss–Newton. All pairs of views are used in one
    system, so that errors do not accumulate around the body. The twist (ω, v) of a view
    moves its points by ω × x + v. The distance n · (x_j − x_i) therefore has the gradient g
    = (x × n, n) with respect to the twist of view j, and −g with respect to that of view i.

    poses: mapping of int to (4, 4) float64, poses of the views to be registered, by number.
    reaches: largest distance of correspondences, one for each step; unit of the points.
    Returns dict of int to (4, 4) float64: the refined poses.

    References
    ----------
    .. [1] Y. Chen and G. Medioni, "Object modelling by registration of multiple range images", Image and
       Vision Computing 10 (1992).
    .. [2] K. Pulli, "Multiview registration for large data sets", 3DIM 1999.
    """
    changed = dict(poses)
    free = [number for number in poses if number not in fixed]
    column = {number: slice(6 * k, 6 * k + 6) for k, number in enumerate(free)}
    pairs = [(i, j) for i in poses for j in poses if i != j and (i in column or j in column)]
    for reach in reaches:
        matrix, right = np.zeros((6 * len(free), 6 * len(free))), np.zeros(6 * len(free))
        middle = np.array([moved(changed[n], views[n].points).mean(axis=0) for n in poses]).mean(axis=0)
        for i, j in pairs:
            points, planes, distance = paired(views[i], views[j], changed[i], changed[j], reach)
            if len(points) < FREEDOMS:
                continue
            # Tukey's biweight, which is zero at the largest distance: the cost is continuous.
            weight = (1 - (distance / reach) ** 2) ** 2
            arm = (points - middle) / reach  # scaled, so that ω and v have the same unit
            gradient = np.concatenate([np.cross(arm, planes), planes], axis=1)  # (p, 6)
            block = gradient.T @ (weight[:, None] * gradient)
            pull = gradient.T @ (weight * distance)
            for number, sign in ((i, 1), (j, -1)):
                if number in column:
                    matrix[column[number], column[number]] += block
                    right[column[number]] += sign * pull
            if i in column and j in column:
                matrix[column[i], column[j]] -= block
                matrix[column[j], column[i]] -= block
        # The minimum-norm solution: undetermined motions, such as a slide along a plane, are zero.
        twist = np.linalg.lstsq(matrix, right, rcond=1e-9)[0].astype(np.float64)
        for number, at in column.items():
            changed[number] = _twist(twist[at], middle, reach) @ changed[number]
    return changed


def _twist(twist: FloatArray, middle: FloatArray, length: float) -> FloatArray:
    """The (4, 4) rigid motion of a twist (ω · length, v) about the point `middle`."""
    from scipy.spatial.transform import Rotation

    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_rotvec(twist[:3] / length).as_matrix()
    motion[:3, 3] = middle + twist[3:] - motion[:3, :3] @ middle
    return motion
