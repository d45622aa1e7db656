"""Reconstruction by growth: bodies of several sizes, scans with holes, and contacts."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import shapes
from benchmarks.uniform import UniformOptions, scan_uniformly

from pcretrieve.errors import ReconstructionError
from pcretrieve.options import ScanOptions, SurfaceOptions
from pcretrieve.points import oriented_normals
from pcretrieve.points.neighbors import neighborhoods, spacing
from pcretrieve.simulation import POSES, body, make_subject
from pcretrieve.surface import SurfaceMarks, body_surfaces, defects
from pcretrieve.surface.reconstruct import uniform_points
from pcretrieve.values import PointCloud, TriangleMesh

CELL = 0.0045  # edge of the voxels for the torus; relative to the diagonal
LIMB_RADIUS = 0.06  # of the limb of `limbed`

TRUE = {
    "ellipsoid": shapes.ellipsoid(),
    "ball": shapes.icosphere(4),
    "torus": shapes.torus(),
    "body": shapes.body(),
}


@cache
def cloud_of(name: str) -> PointCloud:
    return shapes.oriented_points_on(TRUE[name], 8000, noise=0.0005)


def limbed() -> PointCloud:
    """An ellipsoid with a thin limb along x, from 0.9 to 2.7."""
    trunk, limb = shapes.ellipsoid(), shapes.ellipsoid((1.0, LIMB_RADIUS, LIMB_RADIUS))
    along = np.array([1.7, 0, 0])
    one = shapes.oriented_points_on(trunk, 8000)
    other = shapes.oriented_points_on(limb, round(8000 * limb.area / trunk.area))
    one = one.select((((one.points - along) / [1, LIMB_RADIUS, LIMB_RADIUS]) ** 2).sum(axis=1) > 1)
    other = other.select((((other.points + along) / [1, 0.7, 0.5]) ** 2).sum(axis=1) > 1)
    assert one.normals is not None and other.normals is not None
    return PointCloud(
        np.concatenate([one.points, other.points + along]), np.concatenate([one.normals, other.normals])
    )


def surface(cloud: PointCloud, **options: object) -> tuple[TriangleMesh, SurfaceMarks]:
    mesh, marks = next(body_surfaces(cloud, SurfaceOptions.model_validate(options)))
    assert not defects(mesh)
    assert mesh.volume > 0
    return mesh, marks


@pytest.mark.parametrize(
    ("name", "top"),
    [("ellipsoid", 1.0), ("ellipsoid", 0.48), ("body", 9.0)],
    ids=["ellipsoid", "hole", "body"],
)
def test_a_body_comes_back_also_with_a_hole(name: str, top: float) -> None:
    cloud, true = cloud_of(name), TRUE[name]
    mesh, marks = surface(cloud.select(cloud.points[:, 2] < top))
    assert mesh.euler_characteristic == 2
    assert mesh.area == pytest.approx(true.area, rel=0.02)
    assert mesh.volume == pytest.approx(true.volume, rel=0.02)
    assert len(mesh.faces) <= SurfaceOptions().target_faces
    assert not len(marks.cuts)
    assert not len(marks.bridges)
    assert mesh.provenance[-1].sizes["invented"] > 0 or top > 0.48


@pytest.mark.parametrize(("genus", "euler"), [("auto", 0), ("sphere", 2), (1, 0)], ids=str)
def test_a_torus_keeps_the_handles_asked_for(genus: str | int, euler: int) -> None:
    mesh, marks = surface(cloud_of("torus"), genus=genus, cell=CELL)
    assert mesh.euler_characteristic == euler
    assert mesh.volume == pytest.approx(shapes.torus().volume, rel=0.02)
    if euler == 2:
        cloud = cloud_of("torus")
        cell = max(CELL * cloud.diagonal, spacing(neighborhoods(cloud.points, 7, of_some=True)))
        # One cross-section of the tube, one or two voxels thick.
        assert np.hypot(np.hypot(*marks.cuts.T[:2]) - 1, marks.cuts[:, 2]).max() < 0.4 + cell
        assert 0.7 < len(marks.cuts) * cell**2 / (np.pi * 0.4**2) < 2
    else:
        assert not len(marks.cuts)


def test_the_answer_is_the_same_each_time_and_in_each_unit() -> None:
    cloud, unit = cloud_of("body"), 1e-3
    here, again = surface(cloud)[0], surface(cloud)[0]
    np.testing.assert_array_equal(here.faces, again.faces)
    np.testing.assert_array_equal(here.vertices, again.vertices)
    there, _ = surface(PointCloud(unit * cloud.points, normals=cloud.normals))
    assert there.euler_characteristic == here.euler_characteristic
    assert there.area == pytest.approx(unit**2 * here.area, rel=1e-3)
    assert there.volume == pytest.approx(unit**3 * here.volume, rel=1e-3)


def test_a_limb_that_a_hole_cuts_in_two_is_bridged() -> None:
    whole = limbed()
    away = np.abs(whole.points[:, 0] - 1.8) > 0.1
    mesh, marks = surface(whole.select(away))
    assert mesh.euler_characteristic == 2
    assert len(marks.bridges)
    assert (np.abs(marks.bridges[:, 0] - 1.8) < 0.15).all()
    assert np.hypot(marks.bridges[:, 1], marks.bridges[:, 2]).max() < 2 * LIMB_RADIUS
    assert mesh.vertices[:, 0].max() == pytest.approx(2.7, abs=0.05)
    assert "joined a piece with 3" in mesh.provenance[-1].notes[0]
    assert mesh.area == pytest.approx(surface(whole)[0].area, rel=0.02)


def test_limbs_that_touch_are_cut_apart() -> None:
    person = body(make_subject("person", np.random.default_rng(3)), POSES["person"]["hands_on_hips"])
    options = UniformOptions(n_points=15_000, n_holes=0, outlier_share=0)
    cloud = oriented_normals(scan_uniformly(person, options, np.random.default_rng(0)), ScanOptions())
    mesh, marks = surface(cloud)
    assert mesh.euler_characteristic == 2
    assert 0 < len(marks.cuts) < 0.01 * mesh.provenance[-1].sizes["cells"]
    free, _ = surface(cloud, genus="free")
    assert free.euler_characteristic < 0


def test_two_bodies_are_refused() -> None:
    ball = shapes.icosphere(3, 0.6)
    two = shapes.joined(shapes.icosphere(3), TriangleMesh(ball.vertices + np.array([3, 0, 0]), ball.faces))
    message = r"two bodies or more: a second piece has 2\d% of the points; cut them apart, or raise"
    with pytest.raises(ReconstructionError, match=message):
        surface(shapes.oriented_points_on(two, 8000))
    mesh, _ = surface(shapes.oriented_points_on(two, 8000), max_discarded=0.3)
    assert mesh.volume == pytest.approx(shapes.icosphere(3).volume, rel=0.02)


@pytest.mark.parametrize("name", ["ball", "body"])
def test_a_scan_of_one_side_or_without_normals_is_refused(name: str) -> None:
    cloud = cloud_of(name)
    for axis in (0, 2):
        with pytest.raises(ReconstructionError, match="the points must surround a body"):
            surface(cloud.select(cloud.points[:, axis] > 0))
    with pytest.raises(ReconstructionError, match="needs points with normals, these have none"):
        next(body_surfaces(PointCloud(cloud.points), SurfaceOptions()))


# --- points of a surface ------------------------------------------------------------------------------

# Two triangles in the plane z = 2, of areas 3 and 1.
TRIANGLES = TriangleMesh(
    np.array([[0.0, 0, 2], [3, 0, 2], [0, 2, 2], [10, 0, 2], [11, 0, 2], [10, 2, 2]]),
    np.array([[0, 1, 2], [3, 4, 5]]),
)


def test_density_is_that_of_the_area() -> None:
    points, faces = uniform_points(TRIANGLES, 40_000, np.random.default_rng(0))
    second = points[:, 0] >= 10
    np.testing.assert_array_equal(faces, second)
    assert second.mean() == pytest.approx(1 / 4, abs=0.01)
    # The mean of uniform points is the centroid of the triangle.
    np.testing.assert_allclose(points[~second].mean(axis=0), [1, 2 / 3, 2], atol=0.02)
    x, y = points[~second].T[:2]
    assert (x / 3 + y / 2).max() <= 1 + 1e-12
    # Halving the sides about a corner leaves a quarter of the area.
    assert (x / 3 + y / 2 <= 1 / 2).mean() == pytest.approx(1 / 4, abs=0.01)
