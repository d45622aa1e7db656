"""Open3D as functions of arrays: correct and reproducible results, without types of Open3D."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import shapes

from pcretrieve.points.normals import estimate_normals, orient_by_tangent_planes
from pcretrieve.points.register.groups import feature_histograms
from pcretrieve.surface.simplify import decimated
from pcretrieve.values import FloatArray
from pcretrieve.values.conversion import geometry_arrays

BALL = shapes.icosphere(3)
POINTS = shapes.points_on(BALL, 3000, seed=1)
POINTS = POINTS / np.linalg.norm(POINTS, axis=1, keepdims=True)  # so that they are their own normals


@pytest.fixture(scope="module")
def o3d() -> Any:
    import open3d

    return open3d


def geometries(o3d: Any) -> dict[str, tuple[Any, FloatArray, Any, Any]]:
    """Geometries by name, and the points, faces and normals of which they were made."""
    utility, legacy, tensor = o3d.utility, o3d.geometry, o3d.t.geometry
    bare = legacy.PointCloud(utility.Vector3dVector(POINTS))
    cloud = legacy.PointCloud(bare)
    cloud.normals = utility.Vector3dVector(5 * POINTS)  # not of unit length
    mesh = legacy.TriangleMesh(
        utility.Vector3dVector(BALL.vertices.copy()), utility.Vector3iVector(BALL.faces.copy())
    )
    return {
        "points": (bare, POINTS, None, None),
        "points with normals": (cloud, POINTS, None, POINTS),
        "mesh": (mesh, BALL.vertices, BALL.faces, None),
        "tensor points": (tensor.PointCloud.from_legacy(bare, o3d.core.float64), POINTS, None, None),
        "tensor points with normals": (
            tensor.PointCloud.from_legacy(cloud, o3d.core.float64),
            POINTS,
            None,
            POINTS,
        ),
        "tensor mesh": (
            tensor.TriangleMesh.from_legacy(mesh, o3d.core.float64, o3d.core.int64),
            BALL.vertices,
            BALL.faces,
            None,
        ),
    }


# --- exchange -----------------------------------------------------------------------------------------


def test_every_geometry_gives_the_arrays_it_was_made_of(o3d: Any) -> None:
    for name, (geometry, points, faces, normals) in geometries(o3d).items():
        found = geometry_arrays(geometry)
        assert (found[0] == points).all(), name
        for ours, theirs in zip(found[1:], (faces, normals), strict=True):
            assert (ours is None) == (theirs is None), name
            if ours is not None:
                np.testing.assert_allclose(ours.astype(float), theirs, atol=1e-15, err_msg=name)


def test_locked_arrays_go_in_and_stay_as_they_are() -> None:
    points = POINTS.copy()
    points.flags.writeable = False
    estimate_normals(points, n_neighbors=10)
    decimated(BALL, 300)
    assert (points == POINTS).all()


# --- units and places ---------------------------------------------------------------------------------

# A unit that is a power of two changes no digit, however far single precision is from bearing it.
UNITS = [2.0**-150, 2.0**-40, 2.0**10, 2.0**70, 2.0**150]


@pytest.mark.parametrize("unit", UNITS)
def test_points_give_the_same_in_any_unit(unit: float) -> None:
    scaled = unit * POINTS
    for found, expected in (
        (estimate_normals(points, n_neighbors=20) for points in (scaled, POINTS)),
        (orient_by_tangent_planes(points, POINTS, n_neighbors=12) for points in (scaled, POINTS)),
        (feature_histograms(scale * POINTS, POINTS, radius=0.3 * scale) for scale in (unit, 1.0)),
    ):
        np.testing.assert_array_equal(found, expected)


def test_arrays_outlive_their_geometry(o3d: Any) -> None:
    points, _, _ = geometry_arrays(o3d.geometry.PointCloud(o3d.utility.Vector3dVector(POINTS)))
    assert (points == POINTS).all()
    assert points.flags.owndata
