"""Open3D as functions of arrays: the same in any unit, and arrays are neither locked nor changed."""

from __future__ import annotations

import numpy as np
import open3d as o3d
import pytest
import shapes

from pcretrieve.points.normals import estimate_normals, orient_by_tangent_planes
from pcretrieve.points.register.groups import feature_histograms
from pcretrieve.surface.simplify import decimated
from pcretrieve.values.conversion import geometry_arrays

BALL = shapes.icosphere(3)
POINTS = shapes.points_on(BALL, 3000, seed=1)
POINTS = POINTS / np.linalg.norm(POINTS, axis=1, keepdims=True)  # so that they are their own normals


def test_locked_arrays_go_in_and_arrays_outlive_their_geometry() -> None:
    points = POINTS.copy()
    points.flags.writeable = False
    estimate_normals(points, n_neighbors=10)
    decimated(BALL, 300)
    assert (points == POINTS).all()
    found, _, _ = geometry_arrays(o3d.geometry.PointCloud(o3d.utility.Vector3dVector(POINTS)))
    assert (found == POINTS).all() and found.flags.owndata


# A unit that is a power of two changes no digit, however far single precision is from bearing it.
@pytest.mark.parametrize("unit", [2.0**-150, 2.0**-40, 2.0**10, 2.0**70, 2.0**150])
def test_points_give_the_same_in_any_unit(unit: float) -> None:
    scaled = unit * POINTS
    for found, expected in (
        (estimate_normals(points, n_neighbors=20) for points in (scaled, POINTS)),
        (orient_by_tangent_planes(points, POINTS, n_neighbors=12) for points in (scaled, POINTS)),
        (feature_histograms(scale * POINTS, POINTS, radius=0.3 * scale) for scale in (unit, 1.0)),
    ):
        np.testing.assert_array_equal(found, expected)
