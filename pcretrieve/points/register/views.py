"""Range scans → views that are prepared for registration: sensor, foreground, normals, features, samples."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import InputError, ReconstructionError, Stage
from pcretrieve.formats.conf import SENSOR_DISTANCE
from pcretrieve.options import MergeOptions
from pcretrieve.points import open3d
from pcretrieve.points.open3d import feature_histograms
from pcretrieve.points.register.foreground import foreground
from pcretrieve.points.register.range_image import RangeImage
from pcretrieve.values import FloatArray, PointCloud, bounding_diagonal

__all__ = ["View", "features_of", "one_of_each_cell", "prepared"]

# Radius of the neighbourhood of a feature, in voxels. It is of the size of distinctive parts of a body.
FEATURE_RADIUS = 6

# Number of points of each view for registration and verification.
SOME_POINTS = 1000


class View(NamedTuple):
    """A range scan: the points that one sensor measured from one position, prepared for registration.

    points, normals: (k, 3) float64, one point in each voxel.
    sample: (s,) int, positions of a random sample of these points.
    feet: (n, 3) float64, the points of the tangent planes: the foot of the perpendicular from each point of
        the cloud to the least-squares plane of its neighbours.
    spacing: median distance from a point to its nearest neighbour; unit of the file.
    """

    cloud: PointCloud
    points: FloatArray
    normals: FloatArray
    sample: NDArray[np.intp]
    image: RangeImage
    tree: Any
    feet: FloatArray
    spacing: float


def prepared(
    clouds: Sequence[PointCloud], options: MergeOptions, rng: np.random.Generator
) -> tuple[list[View], float]:
    """Prepare range scans for registration.

    clouds: the points that one sensor measured from one position, each in a frame of its own; all in one
        unit.
    Returns scale : float: median diagonal of the views, to which relative options refer; unit of the points.
    """
    sensors = [_sensor(cloud, number, options) for number, cloud in enumerate(clouds)]
    fronts = [
        foreground(cloud, sensor, number, options)
        for number, (cloud, sensor) in enumerate(zip(clouds, sensors, strict=True))
    ]
    scale = float(np.median([bounding_diagonal(points) for points in fronts]))
    views = [
        _view(points, sensor, options, options.cell * scale, rng)
        for points, sensor in zip(fronts, sensors, strict=True)
    ]
    return views, scale


def one_of_each_cell(points: FloatArray, cell: float) -> NDArray[np.intp]:
    """Voxel-grid subsampling: the first point in each voxel.

    points: (n, 3) float64, coordinates.
    cell: edge of a voxel, unit of the points; 0 selects every point.
    Returns (k,) int: positions of the points, ascending.
    """
    if not cell:
        return np.arange(len(points))
    _, first = np.unique(np.floor(points / cell), axis=0, return_index=True)
    return np.sort(first)


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


def features_of(view: View, cell: float) -> FloatArray:
    """Features of the points of a view that are matched.

    cell: edge of the voxels of which each gave one point; unit of the points.
    Returns (k, 33) float64: fast point feature histograms of `View.points`.
    """
    return feature_histograms(view.points, view.normals, radius=FEATURE_RADIUS * cell)


def _view(
    points: FloatArray, sensor: FloatArray, options: MergeOptions, cell: float, rng: np.random.Generator
) -> View:
    """The view of points without background, thinned by voxels of the edge `cell`."""
    from scipy.spatial import cKDTree

    k = min(options.normal_neighbors, len(points))
    normals = open3d.estimate_normals(points, n_neighbors=k)
    normals[np.einsum("ij,ij->i", normals, sensor - points) < 0] *= -1
    few = one_of_each_cell(points, cell)
    tree = cKDTree(points)
    distance, near = map(np.asarray, tree.query(points, k=k))  # (n, k), (n, k)
    height = np.einsum("ij,ij->i", points[near].mean(axis=1) - points, normals)
    return View(
        PointCloud(points, normals, sensor),
        points[few],
        normals[few],
        rng.permutation(len(few))[:SOME_POINTS],
        RangeImage(points, normals, sensor),
        tree,
        points + height[:, None] * normals,
        float(np.median(distance[few, 1])),
    )
