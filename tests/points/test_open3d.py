"""Open3D as functions of arrays: correct and reproducible results, without types of Open3D."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np
import pytest
import shapes

from pcretrieve.errors import ReconstructionError
from pcretrieve.points import open3d as adapter
from pcretrieve.points.open3d import feature_histograms
from pcretrieve.surface.open3d import poisson, simplify
from pcretrieve.surface.topology import compact, defects
from pcretrieve.values import FloatArray, TriangleMesh
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


def test_arrays_outlive_their_geometry(o3d: Any) -> None:
    points, _, _ = geometry_arrays(o3d.geometry.PointCloud(o3d.utility.Vector3dVector(POINTS)))
    assert (points == POINTS).all()
    assert points.flags.owndata


def test_locked_arrays_go_in_and_stay_as_they_are() -> None:
    points = POINTS.copy()
    points.flags.writeable = False
    adapter.estimate_normals(points, n_neighbors=10)
    simplify(BALL.vertices, BALL.faces, n_faces=300)
    assert (points == POINTS).all()


# --- points -------------------------------------------------------------------------------------------


def test_normals_of_a_sphere_are_its_points_up_to_sign() -> None:
    normals = adapter.estimate_normals(POINTS, n_neighbors=20)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-12)
    assert np.abs(np.einsum("ij,ij->i", normals, POINTS)).min() > 0.99


def test_tangent_planes_agree_on_a_side() -> None:
    flips = np.random.default_rng(0).choice([-1.0, 1.0], size=(len(POINTS), 1))
    oriented = adapter.orient_by_tangent_planes(POINTS, POINTS * flips, n_neighbors=12)
    sides = np.sign(np.einsum("ij,ij->i", oriented, POINTS))
    assert abs(sides.sum()) == len(POINTS)


def test_points_without_a_triangulation_have_no_tangent_planes_that_agree() -> None:
    one_place, up = np.zeros((200, 3)), np.tile([0.0, 0.0, 1.0], (200, 1))
    with pytest.raises(ReconstructionError, match="200 points have none") as raised:
        adapter.orient_by_tangent_planes(one_place, up, n_neighbors=12)
    assert raised.value.stage == "orient"


# --- units and places ---------------------------------------------------------------------------------

# A unit that is a power of two changes no digit, however far single precision is from bearing it.
UNITS = [2.0**-150, 2.0**-40, 2.0**10, 2.0**70, 2.0**150]


@pytest.mark.parametrize("unit", UNITS)
def test_points_give_the_same_in_any_unit(unit: float) -> None:
    scaled = unit * POINTS
    for found, expected in (
        (adapter.estimate_normals(points, n_neighbors=20) for points in (scaled, POINTS)),
        (adapter.orient_by_tangent_planes(points, POINTS, n_neighbors=12) for points in (scaled, POINTS)),
        (feature_histograms(scale * POINTS, POINTS, radius=0.3 * scale) for scale in (unit, 1.0)),
    ):
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("unit", UNITS)
def test_surfaces_are_the_same_in_any_unit(unit: float) -> None:
    vertices, faces, density = poisson(unit * POINTS, POINTS, depth=5, scale=1.1)
    expected = poisson(POINTS, POINTS, depth=5, scale=1.1)
    np.testing.assert_array_equal(vertices / unit, expected[0])
    np.testing.assert_array_equal(faces, expected[1])
    np.testing.assert_array_equal(density, expected[2])


@pytest.mark.parametrize("unit", [1e-30, 1e40])
def test_simplification_keeps_the_body_in_any_unit(unit: float) -> None:
    body = shapes.body(4)
    vertices, faces = simplify(unit * body.vertices, body.faces, n_faces=1000)
    assert TriangleMesh(vertices / unit, faces).volume == pytest.approx(body.volume, rel=0.01)


# --- surfaces -----------------------------------------------------------------------------------------


def test_poisson_gives_the_sphere_the_same_one_each_time() -> None:
    vertices, faces, density = poisson(POINTS, POINTS, depth=5, scale=1.1)
    again = poisson(POINTS, POINTS, depth=5, scale=1.1)
    for one, two in zip((vertices, faces, density), again, strict=True):
        np.testing.assert_array_equal(np.asarray(one), np.asarray(two))
    assert faces.dtype == np.int32
    assert density.shape == (len(vertices),)
    surface = compact(vertices, faces)
    assert not defects(surface)
    np.testing.assert_allclose(np.linalg.norm(surface.vertices, axis=1), 1, atol=0.01)
    assert surface.volume == pytest.approx(4 / 3 * np.pi, rel=0.01)


def test_simplification_keeps_the_body() -> None:
    body = shapes.body(4)
    vertices, faces = simplify(body.vertices, body.faces, n_faces=1000)
    coarse = TriangleMesh(vertices, faces)
    assert len(faces) <= 1000
    assert len(faces) > 900
    assert coarse.volume == pytest.approx(body.volume, rel=0.01)


def test_the_viewer_in_a_browser_is_imported_when_it_is_used() -> None:
    program = """
import sys
from pcretrieve.draw.open3d import library

o3d = library()
print("dash" in sys.modules, "plotly" in sys.modules)
figure = o3d.visualization.get_plotly_fig([o3d.geometry.TriangleMesh.create_sphere()])
print("dash" in sys.modules, type(figure).__name__)
"""
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["False", "False", "True", "Figure"]
