"""Reconstruction by growth: bodies with holes and contacts; the coarse surface, which closes the holes."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import shapes
from benchmarks.simulation import POSES, body, make_subject
from benchmarks.uniform import UniformOptions, scan_uniformly

from pcretrieve.errors import ReconstructionError
from pcretrieve.options import ScanOptions, SurfaceOptions
from pcretrieve.points import oriented_normals
from pcretrieve.points.density import local_spacings
from pcretrieve.points.neighbors import (
    PLANE_NEIGHBORS,
    SPACING_NEIGHBORS,
    neighborhoods,
    spacing,
)
from pcretrieve.points.voxels import sampled
from pcretrieve.surface import body_surfaces
from pcretrieve.surface.body import _invented
from pcretrieve.surface.caps import NO_CAP, _stands, capped
from pcretrieve.surface.coarse import (
    BESIDE,
    MARGIN,
    _grid,
    _splatted,
    coarse_surface,
    crossings,
    filled,
    indicator,
)
from pcretrieve.surface.reconstruct import uniform_points
from pcretrieve.values import FloatArray, Grid, PointCloud, Step, TriangleMesh
from pcretrieve.values.topology import SurfaceMarks, defects

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
    one = one.select(
        (((one.points - along) / [1, LIMB_RADIUS, LIMB_RADIUS]) ** 2).sum(axis=1) > 1
    )
    other = other.select((((other.points + along) / [1, 0.7, 0.5]) ** 2).sum(axis=1) > 1)
    assert one.normals is not None and other.normals is not None
    return PointCloud(
        np.concatenate([one.points, other.points + along]),
        np.concatenate([one.normals, other.normals]),
    )


def surface(cloud: PointCloud, **options: object) -> tuple[TriangleMesh, SurfaceMarks]:
    near = neighborhoods(cloud.points, PLANE_NEIGHBORS + 1)
    chosen = SurfaceOptions.model_validate(options)
    mesh, marks = next(body_surfaces(cloud, chosen, near))
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
    assert len(marks.cuts) == len(marks.bridges) == 0
    assert mesh.provenance[-1].sizes["invented"] > 0 or top > 0.48


@pytest.mark.parametrize(
    ("genus", "euler"), [("auto", 0), ("sphere", 2), (1, 0)], ids=str
)
def test_a_torus_keeps_the_handles_asked_for(genus: str | int, euler: int) -> None:
    mesh, marks = surface(cloud_of("torus"), genus=genus, cell=CELL)
    assert mesh.euler_characteristic == euler
    assert mesh.volume == pytest.approx(shapes.torus().volume, rel=0.02)
    if euler == 2:
        cloud = cloud_of("torus")
        cell = max(
            CELL * cloud.diagonal, spacing(neighborhoods(cloud.points, 7, of_some=True))
        )
        # One cross-section of the tube, one or two voxels thick.
        assert (
            np.hypot(np.hypot(*marks.cuts.T[:2]) - 1, marks.cuts[:, 2]).max() < 0.4 + cell
        )
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
    """Along the contacts alone: of eight samples of the body, 0.9 to 1.1 % of the voxels are taken out."""
    person = body(
        make_subject("person", np.random.default_rng(3)), POSES["person"]["hands_on_hips"]
    )
    options = UniformOptions(n_points=15_000, n_holes=0, outlier_share=0)
    cloud = oriented_normals(
        scan_uniformly(person, options, np.random.default_rng(0)), ScanOptions()
    )
    (parted, _), (free, _) = surface(cloud), surface(cloud, genus="free")
    assert parted.euler_characteristic == 2 > 0 > free.euler_characteristic
    n_parted, n_free = (mesh.provenance[-1].sizes["cells"] for mesh in (parted, free))
    assert 0.005 < 1 - n_parted / n_free < 0.02


def test_two_bodies_are_refused() -> None:
    ball = shapes.icosphere(3, 0.6)
    two = shapes.joined(
        shapes.icosphere(3), TriangleMesh(ball.vertices + np.array([3, 0, 0]), ball.faces)
    )
    message = r"two bodies or more: a second piece has 2\d% of the points; cut them apart, or raise"
    with pytest.raises(ReconstructionError, match=message):
        surface(shapes.oriented_points_on(two, 8000))
    mesh, _ = surface(shapes.oriented_points_on(two, 8000), max_discarded=0.3)
    assert mesh.volume == pytest.approx(shapes.icosphere(3).volume, rel=0.02)
    assert capped(two, shapes.oriented_points_on(ball, 2000), spacing=0.05).surface == two


@pytest.mark.parametrize("name", ["ball", "body"])
def test_a_scan_of_one_side_or_without_normals_is_refused(name: str) -> None:
    cloud = cloud_of(name)
    for axis in (0, 2):
        with pytest.raises(ReconstructionError, match="the points must surround a body"):
            surface(cloud.select(cloud.points[:, axis] > 0))
    with pytest.raises(
        ReconstructionError, match="needs points with normals, these have none"
    ):
        surface(PointCloud(cloud.points))


def test_density_of_points_is_that_of_the_area() -> None:
    """On two triangles, of areas 3 and 1."""
    corners = np.array(
        [[0.0, 0, 2], [3, 0, 2], [0, 2, 2], [10, 0, 2], [11, 0, 2], [10, 2, 2]]
    )
    both = TriangleMesh(corners, np.array([[0, 1, 2], [3, 4, 5]]))
    points, faces = uniform_points(both, 40_000, np.random.default_rng(0))
    second = points[:, 0] >= 10
    np.testing.assert_array_equal(faces, second)
    assert second.mean() == pytest.approx(1 / 4, abs=0.01)
    # The mean of uniform points is the centroid of the triangle.
    np.testing.assert_allclose(points[~second].mean(axis=0), [1, 2 / 3, 2], atol=0.02)
    x, y = points[~second].T[:2]
    assert (x / 3 + y / 2).max() <= 1 + 1e-12
    # Halving the sides about a corner leaves a quarter of the area.
    assert (x / 3 + y / 2 <= 1 / 2).mean() == pytest.approx(1 / 4, abs=0.01)


# --- the coarse surface -------------------------------------------------------------------------------

EGG = shapes.ellipsoid((0.6, 0.7, 1.0), subdivisions=4)
ON_EGG = shapes.oriented_points_on(EGG, 20_000)


# A body that ends like a limb where it is cut: its width hardly changes there.
LONG = shapes.ellipsoid((0.3, 0.35, 1.5), subdivisions=4)
ON_LONG = shapes.oriented_points_on(LONG, 20_000)


@pytest.mark.parametrize("unit", [1.0, 1e-160, 1e100])
def test_the_indicator_function_is_one_inside_and_zero_outside(unit: float) -> None:
    points = unit * ON_EGG.points
    grid = Grid.around(points, 0.04 * unit, 10)
    assert ON_EGG.normals is not None
    spacings = local_spacings(neighborhoods(points, SPACING_NEIGHBORS + 1))
    values = indicator(points, ON_EGG.normals, spacings, grid)
    for reach, expected, error in ((0.8, 1, 0.2), (1.2, 0, 0.1)):
        at = grid.coordinates(unit * reach * EGG.vertices)
        assert sampled(values, at) == pytest.approx(expected, abs=error)


def test_vectors_are_shared_among_the_voxels_around_them_without_a_loss() -> None:
    """Trilinear weights keep the sum of the vectors, and the mean of their places."""
    random = np.random.default_rng(0)
    at, vectors = random.uniform(0, 4, size=(9, 3)), random.normal(size=(9, 3))
    field = _splatted(at, vectors, (5, 6, 7)).astype(float)
    np.testing.assert_allclose(field.sum(axis=(1, 2, 3)), vectors.sum(axis=0), atol=1e-5)
    moments = np.einsum("vabc,wabc->vw", field, np.indices((5, 6, 7)).astype(float))
    np.testing.assert_allclose(moments, vectors.T @ at, atol=1e-4)
    alone = _splatted(np.array([[1.25, 2.0, 3.5]]), np.array([[1.0, 0, 0]]), (5, 6, 7))
    assert np.argwhere(alone)[:, 1:].tolist() == [
        [1, 2, 3],
        [1, 2, 4],
        [2, 2, 3],
        [2, 2, 4],
    ]


def test_a_finer_coarse_grid_has_no_voxels_smaller_than_the_least() -> None:
    corners = np.array([[0.0, 0, 0], [1, 0.2, 0.1]])
    side = 1 + 2 * MARGIN
    for finer, least, expected in (
        (1, 0, 64),
        (2, 0, 128),
        (2, side / 90, 90),
        (2, 1, 64),
    ):
        assert _grid(corners, 64, finer, least).cell == pytest.approx(side / expected)


def test_a_body_with_large_holes_has_a_finer_coarse_grid(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made: list[int] = []

    def recorded(points: FloatArray, n: int, finer: int, least: float) -> Grid:
        made.append(n * finer)
        return _grid(points, n, finer, least)

    monkeypatch.setattr("pcretrieve.surface.coarse._grid", recorded)
    for height, finest in ((2.0, 64), (0.9, 128)):
        made.clear()
        cloud = ON_EGG.select(ON_EGG.points[:, 2] < height)
        around = neighborhoods(cloud.points, 9)
        coarse_surface(cloud, SurfaceOptions(), around, spacing=spacing(around))
        assert max(made) == finest


def test_holes_of_a_round_body_are_closed_round() -> None:
    for height in (2.0, 0.996, 0.9, 0.7):
        cloud = ON_EGG.select(ON_EGG.points[:, 2] < height)
        around = neighborhoods(cloud.points, 9)
        found, _ = coarse_surface(
            cloud, SurfaceOptions(), around, spacing=spacing(around)
        )
        assert defects(found.surface).boundary_edges == 0
        # The cap of the largest hole is .16 too high.
        most = 0.08 if height < 0.9 else 0.07
        assert found.surface.volume == pytest.approx(EGG.volume, rel=most)
        assert found.surface.vertices[:, 2].max() == pytest.approx(1, abs=0.17)
        assert (found.cap != NO_CAP).any() == (height < 0.99)
        assert not found.base.any()


def test_a_hole_at_the_crown_keeps_the_height() -> None:
    mesh, marks = surface(ON_EGG.select(ON_EGG.points[:, 2] < 0.7), reconstructions=1)
    assert mesh.vertices[:, 2].max() == pytest.approx(1, abs=0.05)
    assert mesh.volume == pytest.approx(EGG.volume, rel=0.02)
    assert len(marks.base) == 0


@pytest.mark.parametrize("sensors", [False, True], ids=["points", "sensors"])
def test_a_body_that_stood_on_a_ground_is_flat_there(sensors: bool) -> None:
    down = np.array([0, 0, -1.0])
    cloud = ON_LONG.select(ON_LONG.points @ down < 0.3)
    cloud = cloud.after(Step("crop", 0.0, {"up_x": 0.0, "up_y": 0.0, "up_z": 1.0}))
    if sensors:
        cloud = replace(cloud, viewpoints=5 * cloud.points)
    mesh, marks = surface(cloud, reconstructions=1)
    assert (mesh.vertices @ down).max() < 0.35  # the rim, by a few voxels
    assert np.median(marks.base @ down) == pytest.approx(0.3, abs=0.02)
    below = np.pi * 0.3 * 0.35 * (1.8 - (1.5**3 + 0.3**3) / (3 * 1.5**2))
    assert mesh.volume == pytest.approx(below, rel=0.02)


def test_the_end_of_a_limb_that_was_cut_off_is_known() -> None:
    cloud = ON_LONG.select(ON_LONG.points[:, 2] < 0.3)
    mesh, marks = surface(cloud, reconstructions=1)
    # A dome, lower than half a ball of the width of the limb.
    assert 0.33 < mesh.vertices[:, 2].max() < 0.3 + 0.35
    assert np.median(marks.base[:, 2]) == pytest.approx(0.3, abs=0.02)


# --- what is inside -----------------------------------------------------------------------------------

GRID = Grid(np.array([1.0, -2.0, 3.0]), 0.5, (24, 24, 24))
RADIUS = 8.234  # voxels


def octahedron(centre: FloatArray) -> tuple[TriangleMesh, np.ndarray]:
    """The mesh, and the voxels whose centres it contains."""
    corners = np.concatenate([np.eye(3), -np.eye(3)]) * RADIUS + centre
    faces = [
        [0, 1, 2],
        [1, 3, 2],
        [3, 4, 2],
        [4, 0, 2],
        [1, 0, 5],
        [3, 1, 5],
        [4, 3, 5],
        [0, 4, 5],
    ]
    solid = (
        np.abs(np.moveaxis(np.indices(GRID.shape), 0, -1) - centre).sum(axis=-1) < RADIUS
    )
    return TriangleMesh(GRID.centres(corners), np.array(faces, dtype=np.int32)), solid


def test_voxels_inside_are_those_of_the_solid_but_for_the_border_of_the_grid() -> None:
    for centre in (
        [12.31, 11.62, 12.27],
        [12 + BESIDE[0], 12 + BESIDE[1], 12.3],  # edges on lines
        [12 + BESIDE[0], 12 + BESIDE[0], 12 + BESIDE[1]],  # vertices on lines
        [12.0, 12.0, 12.0],  # vertices on voxels
        # What sticks out of the grid is cut off.
        *(
            np.where(np.arange(3) == axis, end, 12.27)
            for axis in range(3)
            for end in (3.31, 19.62)
        ),
    ):
        mesh, solid = octahedron(np.array(centre))
        solid = np.pad(solid[1:-1, 1:-1, 1:-1], 1)
        np.testing.assert_array_equal(filled(mesh, GRID), solid)


def test_crossings_lie_on_the_surface() -> None:
    centre = np.array([12.31, 11.62, 12.27])
    mesh, inside = octahedron(centre)
    for axis in range(3):
        here = np.argwhere(np.isfinite(shares := crossings(mesh, GRID, axis)))
        turns = np.argwhere(np.diff(inside.astype(int), axis=axis))
        # A line near an edge may cross the mesh twice between two voxels.
        assert set(map(tuple, turns)) <= set(map(tuple, here))
        places = here.astype(float)
        places[:, axis] += shares[tuple(here.T)]
        np.testing.assert_allclose(np.abs(places - centre).sum(axis=1), RADIUS, atol=1e-3)


def test_a_base_may_lie_above_less_than_three_tenths_of_the_points() -> None:
    """Those that touch its plane are not beneath it."""
    rng = np.random.default_rng(0)
    base = np.column_stack([rng.uniform(-1, 1, (50, 2)), np.zeros(50)])
    for n_beneath, stands in ((280, True), (320, False)):
        height = np.repeat([-1.0, 0.0, 1.0], [n_beneath, 50, 950 - n_beneath])
        points = np.column_stack([rng.uniform(-0.9, 0.9, (1000, 2)), height])
        assert _stands(base, np.array([0, 0, -1.0]), PointCloud(points)) == stands


def test_a_quarter_of_a_sheet_may_be_invented_but_not_on_one_side() -> None:
    sheet = shapes.ellipsoid((1, 1, 0.05), subdivisions=4)
    x, _, z = sheet.vertices.T
    both = x > np.quantile(x, 0.75)
    assert _invented(sheet, both) == pytest.approx(0.25, abs=0.01)
    one = (z > 0) & (x > np.quantile(x[z > 0], 0.5))
    assert one.mean() < 0.26
    with pytest.raises(
        ReconstructionError, match="had to be invented, on one side: scan the"
    ):
        _invented(sheet, one)
