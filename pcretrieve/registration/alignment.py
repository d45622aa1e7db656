"""Views that nearly meet → views that do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.adapters import open3d
from pcretrieve.options import MergeOptions
from pcretrieve.registration.range_image import LEAST_COSINE, RangeImage
from pcretrieve.types import FloatArray, PointCloud

__all__ = ["Poses", "View", "adjusted", "moved", "one_of_each_cell", "paired", "turned", "view_of"]

# Neighbours that a normal is fitted to; points.
NORMAL_NEIGHBORS = 16

# Radius of a feature, in cells: large enough to tell a nose from a knee.
FEATURE_RADIUS = 6

# Points of each view that poses are adjusted and judged by.
SOME_POINTS = 1000

# A plane is looked for at the nearest point, which lies this many spacings beside it at most.
BESIDE = 2

# Fewer pairs of points than a rigid motion has freedoms say nothing of it.
FREEDOMS = 6

Poses = Mapping[int, FloatArray]
"""Rigid motions (4, 4) into a common frame, by the number of the view."""


class View(NamedTuple):
    """What one sensor saw, made ready to be aligned, in its own frame.

    Attributes
    ----------
    cloud : PointCloud
        With normals that face the sensor, and its position.
    points, normals : (k, 3) float64
        One point of each cell.
    features : (k, 33) float64
        How the surface turns about each of them.
    sample : (s,) int
        Some of them, at random.
    image : RangeImage
    tree : cKDTree
        Of all points of the cloud.
    spacing : float
        Median distance from a point to the next; unit of the file.
    """

    cloud: PointCloud
    points: FloatArray
    normals: FloatArray
    features: FloatArray
    sample: NDArray[np.intp]
    image: RangeImage
    tree: Any
    spacing: float


def view_of(
    points: FloatArray, sensor: FloatArray, scale: float, options: MergeOptions, rng: np.random.Generator
) -> View:
    """The points that one sensor saw, made ready.

    Parameters
    ----------
    points : (n, 3) float64
    sensor : (3,) float64
    scale : float
        What relative lengths refer to; unit of the points.
    """
    from scipy.spatial import cKDTree

    normals = open3d.estimate_normals(points, n_neighbors=NORMAL_NEIGHBORS)
    normals[np.einsum("ij,ij->i", normals, sensor - points) < 0] *= -1
    cell = options.cell * scale
    few = one_of_each_cell(points, cell)
    tree = cKDTree(points)
    return View(
        PointCloud(points, normals, sensor),
        points[few],
        normals[few],
        open3d.feature_histograms(points[few], normals[few], radius=FEATURE_RADIUS * cell),
        rng.permutation(len(few))[:SOME_POINTS],
        RangeImage(points, normals, sensor),
        tree,
        float(np.median(np.asarray(tree.query(points[few], k=2)[0])[:, 1])),
    )


def one_of_each_cell(points: FloatArray, cell: float) -> NDArray[np.intp]:
    """Positions of the first point in each cell, ascending; of every point where cells have no size."""
    if not cell:
        return np.arange(len(points))
    _, first = np.unique(np.floor(points / cell), axis=0, return_index=True)
    return np.sort(first)


def moved(motion: FloatArray, points: FloatArray) -> FloatArray:
    """(n, 3) points under a motion (4, 4); under each of several, (m, 4, 4), they are (m, n, 3)."""
    return np.asarray(turned(motion, points) + motion[..., None, :3, 3])


def turned(motion: FloatArray, directions: FloatArray) -> FloatArray:
    """The same for directions."""
    return np.asarray(directions @ np.swapaxes(motion[..., :3, :3], -1, -2))


def paired(
    first: View, second: View, first_pose: FloatArray, second_pose: FloatArray, reach: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points of `second` within `reach` of the surface of `first` that face the same way.

    Returns
    -------
    points, planes : (p, 3) float64
        Points of the sample of `second`, and the normals of their nearest neighbours in `first`, in the
        common frame.
    distance : (p,) float64
        From those tangent planes, positive in front.
    """
    motion = np.linalg.inv(first_pose) @ second_pose  # from the frame of `second` to that of `first`
    points = moved(motion, second.points[second.sample])
    normals = turned(motion, second.normals[second.sample])
    # Near the rim of a view, or between its points, the nearest point is beside the foot of the distance.
    bound = np.hypot(reach, BESIDE * first.spacing)
    nearest = np.asarray(first.tree.query(points, distance_upper_bound=bound)[1])
    near = nearest < len(first.cloud.points)
    points, normals, nearest = points[near], normals[near], nearest[near]
    planes = np.asarray(first.cloud.normals)[nearest]
    distance = np.einsum("ij,ij->i", points - first.cloud.points[nearest], planes)
    kept = (np.abs(distance) < reach) & (np.einsum("ij,ij->i", normals, planes) > LEAST_COSINE)
    return moved(first_pose, points[kept]), turned(first_pose, planes[kept]), distance[kept]


def adjusted(
    views: Sequence[View], poses: Poses, *, fixed: Sequence[int], reaches: Sequence[float]
) -> dict[int, FloatArray]:
    """The poses, changed so that all surfaces meet.

    Gauss–Newton on the distances of points to the tangent planes of their nearest neighbours in every other
    view, all pairs of views at once, so that no error adds up round the body [1]_. The twist (ω, v) of a view
    moves its points by ω × x + v. A distance n · (x_j − x_i) thus has the gradient g = (x × n, n) in the
    twist of view j, and −g in that of view i.

    Parameters
    ----------
    fixed : sequence of int
        Views that stay where they are.
    reaches : sequence of float
        Distance within which points are paired, step by step; unit of the points.

    References
    ----------
    .. [1] Pulli, "Multiview registration for large data sets", 3DIM 1999; the distance is that of Chen and
       Medioni, "Object modelling by registration of multiple range images", IVC 1992.
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
            # Tukey's biweight: a pair that goes out of reach had no weight left when it went.
            weight = (1 - (distance / reach) ** 2) ** 2
            arm = (points - middle) / reach  # so that ω and v are of one size
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
        # Least squares: a view without pairs stays, and so does one on a plane along that plane.
        twist = np.linalg.lstsq(matrix, right, rcond=1e-9)[0].astype(np.float64)
        for number, at in column.items():
            changed[number] = _twist(twist[at], middle, reach) @ changed[number]
    return changed


def _twist(twist: FloatArray, middle: FloatArray, length: float) -> FloatArray:
    """(4, 4) motion of a twist (ω · length, v) about `middle`."""
    from scipy.spatial.transform import Rotation

    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_rotvec(twist[:3] / length).as_matrix()
    motion[:3, 3] = middle + twist[3:] - motion[:3, :3] @ middle
    return motion
