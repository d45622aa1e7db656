"""Simultaneous registration of views from approximate poses (multi-view ICP)."""

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

# Number of neighbours for a normal.
NORMAL_NEIGHBORS = 16

# Radius of the neighbourhood of a feature, in voxels. It is of the size of distinctive parts of a body.
FEATURE_RADIUS = 6

# Number of points of each view for registration and verification.
SOME_POINTS = 1000

# Largest distance, in spacings, of the nearest point from the foot of the perpendicular to its tangent plane.
BESIDE = 2

# Degrees of freedom of a rigid motion, and smallest number of correspondences between two views.
FREEDOMS = 6

Poses = Mapping[int, FloatArray]
"""Rigid motions, (4, 4) float64, of views into a common frame, by the number of the view."""


class View(NamedTuple):
    """A range scan: the points that one sensor measured from one position, prepared for registration.

    Attributes
    ----------
    cloud : PointCloud
        The points in the frame of the view, with normals towards the sensor, and its position.
    points, normals : (k, 3) float64
        One point in each voxel.
    features : (k, 33) float64
        Fast point feature histograms of these points.
    sample : (s,) int
        Positions of a random sample of these points.
    image : RangeImage
        The range image of the cloud.
    tree : cKDTree
        The k-d tree of all points of the cloud.
    spacing : float
        Median distance from a point to its nearest neighbour; unit of the file.
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
    """Prepare a view for registration.

    Parameters
    ----------
    points : (n, 3) float64
        Coordinates, without background.
    sensor : (3,) float64
        Position of the sensor; unit of the points.
    scale : float
        The length to which relative options refer; unit of the points.
    options : MergeOptions
        Of which `cell` is used.
    rng : numpy.random.Generator
        For the sample.

    Returns
    -------
    View
        The view in its own frame.
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
    """Voxel-grid subsampling: the first point in each voxel.

    Parameters
    ----------
    points : (n, 3) float64
        Coordinates.
    cell : float
        Edge of a voxel, unit of the points; 0 selects every point.

    Returns
    -------
    (k,) int
        Positions of the points, ascending.
    """
    if not cell:
        return np.arange(len(points))
    _, first = np.unique(np.floor(points / cell), axis=0, return_index=True)
    return np.sort(first)


def moved(motion: FloatArray, points: FloatArray) -> FloatArray:
    """Apply rigid motions to points.

    Parameters
    ----------
    motion : (4, 4) or (m, 4, 4) float64
        One motion, or m motions.
    points : (n, 3) float64
        Coordinates.

    Returns
    -------
    (n, 3) or (m, n, 3) float64
        Coordinates after the motion, or after each motion.
    """
    return np.asarray(turned(motion, points) + motion[..., None, :3, 3])


def turned(motion: FloatArray, directions: FloatArray) -> FloatArray:
    """Apply the rotations of rigid motions to directions.

    Parameters
    ----------
    motion : (4, 4) or (m, 4, 4) float64
        One motion, or m motions.
    directions : (n, 3) float64
        Vectors.

    Returns
    -------
    (n, 3) or (m, n, 3) float64
        Vectors after the rotation, or after each rotation.
    """
    return np.asarray(directions @ np.swapaxes(motion[..., :3, :3], -1, -2))


def paired(
    first: View, second: View, first_pose: FloatArray, second_pose: FloatArray, reach: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Point-to-plane correspondences of two views: nearest neighbours with similar normals.

    Parameters
    ----------
    first, second : View
        The views.
    first_pose, second_pose : (4, 4) float64
        Their poses in the common frame.
    reach : float
        Largest distance between a point and the tangent plane of its nearest neighbour; unit of the points.

    Returns
    -------
    points : (p, 3) float64
        Points of the sample of `second`, in the common frame.
    planes : (p, 3) float64
        Unit normals of their nearest neighbours in `first`, in the common frame.
    distance : (p,) float64
        Signed distances from the tangent planes, positive on the side of the normal; unit of the points.
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
    distance = np.einsum("ij,ij->i", points - first.cloud.points[nearest], planes)
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

    Parameters
    ----------
    views : sequence of View
        All views.
    poses : mapping of int to (4, 4) float64
        Poses of the views to be registered, by number.
    fixed : sequence of int
        Numbers of the views whose poses do not change.
    reaches : sequence of float
        Largest distance of correspondences, one for each step; unit of the points.

    Returns
    -------
    dict of int to (4, 4) float64
        The refined poses.

    References
    ----------
    .. [1] Y. Chen and G. Medioni, "Object modelling by registration of multiple
           range images", Image and Vision
       Computing 10 (1992).
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
