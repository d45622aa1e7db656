"""Neighbours are those of a k-d tree, their planes those of LAPACK; spacing, noise, density; normals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapes
from scipy.spatial import cKDTree

from pcretrieve.errors import ReconstructionError
from pcretrieve.options import ScanOptions
from pcretrieve.pipeline.registration.groups import feature_histograms
from pcretrieve.points import oriented_normals
from pcretrieve.points.density import local_spacings, sparse_points
from pcretrieve.points.neighbors import (
    Neighborhoods,
    guided_planes,
    nearest,
    neighborhoods,
    noise,
    plane_deviations,
    spacing,
)
from pcretrieve.points.normals import estimate_normals, orient_by_tangent_planes
from pcretrieve.values import FloatArray, PointCloud, TriangleMesh

RNG = np.random.default_rng(0)


ON_SPHERE = shapes.on_sphere(4000)
CLOUDS = {
    "sphere": ON_SPHERE,
    "far from the origin": ON_SPHERE + 1e6,
    "cube": RNG.random((3000, 3)),
    "plane": np.pad(RNG.random((2000, 2)), ((0, 0), (0, 1))),
    "line": np.pad(RNG.random((500, 1)), ((0, 0), (0, 2))),
    "of very different density": RNG.normal(size=(3000, 3)) ** 5,
    "with strays": np.concatenate([ON_SPHERE, [[1e5, 0, 0], [0, -1e7, 3]]]),
}


@pytest.mark.parametrize("points", CLOUDS.values(), ids=CLOUDS)
def test_the_nearest_points_are_those_of_a_tree(points: FloatArray) -> None:
    beside = points.mean(axis=0) + 1.5 * (points[::7] - points.mean(axis=0))
    for places in (points, beside):
        distance, near = nearest(points, places, 9)
        expected, numbers = cKDTree(points).query(places, k=np.arange(1, 10))
        np.testing.assert_array_equal(distance, expected)
        np.testing.assert_array_equal(near, numbers)


def test_points_that_coincide_are_neighbours_at_distance_zero() -> None:
    points = np.repeat(CLOUDS["cube"][:100], 3, axis=0)
    distance, near = nearest(points, points, 3)
    assert (distance == 0).all()
    assert (np.sort(near, axis=1) // 3 == np.arange(300)[:, None] // 3).all()


# --- planes -------------------------------------------------------------------------------------------

K = 9
GROUPS = (
    RNG.normal(size=(200, K, 3))
    * [1.0, 0.7, 0.05]
    @ np.linalg.qr(RNG.normal(size=(3, 3)))[0]
    + 5
)
OF_GROUP = np.arange(200 * K).reshape(200, K)


def test_deviations_are_the_smallest_singular_values() -> None:
    centred = GROUPS - GROUPS.mean(axis=1, keepdims=True)
    expected = np.linalg.svd(centred, compute_uv=False)[:, 2] / np.sqrt(K - 3)
    np.testing.assert_allclose(
        plane_deviations(GROUPS.reshape(-1, 3), OF_GROUP), expected, rtol=1e-9
    )


@pytest.mark.parametrize("unit", [1.0, 2.0**-80])
def test_normals_are_the_last_eigenvectors_with_the_orientation_of_the_guide(
    unit: float,
) -> None:
    points = unit * GROUPS.reshape(-1, 3)
    near = np.repeat(OF_GROUP, K, axis=0)  # of each point, all points of its group
    distance = np.zeros(near.shape)
    distance[:, -1] = (
        unit  # no weight depends on the distance, except that of the last neighbour
    )
    guide = np.tile([0.6, 0.0, 0.8], (len(points), 1))
    normals = guided_planes(points, guide, near, distance)
    weight = np.append(np.ones(K - 1), np.exp(-(0.7**-2)))
    for group, normal in zip(GROUPS, normals[::K], strict=True):
        centred = group - weight @ group / weight.sum()
        axis = np.linalg.eigh(centred.T @ (weight[:, None] * centred))[1][:, 0]
        np.testing.assert_allclose(normal, axis * np.sign(axis @ guide[0]), atol=1e-10)


def test_a_neighbourhood_without_a_plane_has_a_unit_normal() -> None:
    near, distance = np.tile(np.arange(K), (K, 1)), np.ones((K, K))
    normals = guided_planes(np.ones((K, 3)), np.zeros((K, 3)), near, distance)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)


# --- spacing, noise and density -----------------------------------------------------------------------


def test_regular_and_random_samplings_have_the_same_spacing() -> None:
    side, n = 0.02, 50
    i, j = np.indices((n, n)).reshape(2, -1)
    regular = side * np.column_stack([i, j, np.zeros(n * n)])
    scattered = np.random.default_rng(0).random((n * n, 3)) * [side * n, side * n, 0]
    for points in (regular, scattered):
        neighbors = neighborhoods(points, 9)
        assert spacing(neighbors) == pytest.approx(side, rel=0.15)
        assert np.median(local_spacings(neighbors)) == pytest.approx(spacing(neighbors))


def test_noise_is_what_was_added_however_many_points_there_are() -> None:
    for n_points in (10_000, 40_000):
        points = shapes.oriented_points_on(shapes.ellipsoid(), n_points).points
        for share in (0.0005, 0.002):
            deviation = share * float(np.linalg.norm(np.ptp(points, axis=0)))
            noisy = points + np.random.default_rng(0).normal(0, deviation, points.shape)
            found = noise(noisy, neighborhoods(noisy, 9, of_some=True))
            assert found == pytest.approx(0.8 * deviation, rel=0.25)


def test_sparse_points_are_many_on_a_surface_and_not_isolated() -> None:
    for n_sparse, spacing_, exponent, expected in (
        (2, 0.04, 1 / 2, 0),  # too few
        (100, 0.04, 1 / 2, 100),
        (100, 0.04, 1 / 3, 0),  # in a volume
        (100, 0.4, 1 / 2, 0),  # isolated
    ):
        spacings = np.where(np.arange(1000) < n_sparse, spacing_, 0.01)
        # The distance of neighbour k grows like k^exponent.
        growth = np.concatenate([[0], (np.arange(1, 21) / 6) ** exponent])
        distance = np.sqrt(6 / np.pi) * spacings[:, None] * growth
        neighbors = Neighborhoods(distance, np.zeros(distance.shape, dtype=np.intp))
        assert sparse_points(neighbors, cell=0.01, diagonal=1).sum() == expected


# --- normals ------------------------------------------------------------------------------------------

SURFACES = {"ball": shapes.icosphere(3), "torus": shapes.torus(), "body": shapes.body()}


def scanned(mesh: TriangleMesh, n: int = 8000) -> tuple[PointCloud, FloatArray]:
    """Points on a mesh, and the normals of the faces that they lie on."""
    cloud = shapes.oriented_points_on(mesh, n)
    assert cloud.normals is not None
    return PointCloud(cloud.points), cloud.normals


def share_right(cloud: PointCloud, true: FloatArray) -> float:
    assert cloud.normals is not None
    np.testing.assert_allclose(np.linalg.norm(cloud.normals, axis=1), 1)
    return float((np.einsum("ij,ij->i", cloud.normals, true) > 0).mean())


@pytest.mark.parametrize("name", SURFACES)
@pytest.mark.parametrize("method", ["flood", "tangent-plane"])
def test_normals_point_outwards(method: str, name: str) -> None:
    cloud, true = scanned(SURFACES[name])
    assert (
        share_right(oriented_normals(cloud, ScanOptions(orientation=method)), true) > 0.99
    )


def test_the_two_sides_of_a_thin_plate_look_away_from_each_other() -> None:
    """A sheet thinner than a neighbourhood: no plane may be fitted to points of both sides."""
    side, other = (shapes.points_on(shapes.square(1), 4000, seed=seed) for seed in (0, 1))
    up = np.repeat([1, -1], 4000)
    for thickness in (0.03, 0.04, 0.06):
        points = np.concatenate([side + np.array([0, 0, thickness]), other])
        normals = oriented_normals(PointCloud(points), ScanOptions()).normals
        assert normals is not None
        inner = (np.abs(points[:, :2] - 0.5) < 0.45).all(axis=1)
        assert (up * normals[:, 2] > 0.95)[inner].mean() > 0.99


def test_a_fin_of_few_points_is_no_leak() -> None:
    """As on hands of scans of 10,000 points, normals of both sides disagree whatever holes are closed."""
    ball = shapes.on_sphere(8000)
    rng = np.random.default_rng(1)
    fin = rng.random((127, 3)) * [0.5, 0.2, 0] + [0.98, -0.1, 0.015]
    fin[::2, 2] *= -1
    cloud = PointCloud(np.concatenate([ball, fin]))
    oriented = oriented_normals(cloud, ScanOptions())
    assert oriented.normals is not None
    assert (oriented.normals[:8000] * ball).sum(axis=1).min() > 0
    # Tangent planes would decide by the highest point, and across the fin.
    notes = [note for step in oriented.provenance for note in step.notes]
    assert not any("tangent planes" in note for note in notes)


def test_auto_prefers_sensors_to_normals_and_normals_to_a_flood_fill() -> None:
    cloud, true = scanned(SURFACES["torus"])
    assert share_right(oriented_normals(cloud, ScanOptions()), true) > 0.99
    given = oriented_normals(replace(cloud, normals=true), ScanOptions())
    assert given.normals is not None
    np.testing.assert_array_equal(given.normals, true)
    assert given.provenance[-1].notes == ("used the file's own normals",)
    # The inner side of the torus too has a sensor that sees it.
    seen = replace(cloud, normals=-true, viewpoints=cloud.points + 0.1 * true)
    assert share_right(oriented_normals(seen, ScanOptions()), true) == 1


CAMERAS = 3 * np.array([[np.cos(a), np.sin(a), 0] for a in np.arange(6) * np.pi / 3])


@pytest.mark.parametrize(
    "kind", ["inwards", "of any sign", "of a part", "directions of view"]
)
def test_normals_that_the_flood_fill_contradicts_are_not_used(kind: str) -> None:
    cloud, true = scanned(SURFACES["body"])
    signs = np.random.default_rng(0).choice([-1, 1], (len(true), 1))
    rays = CAMERAS[:, None] - cloud.points
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    best = np.einsum("ijk,jk->ij", rays, true).argmax(axis=0)
    top = cloud.points[:, 2] > np.quantile(cloud.points[:, 2], 0.8)
    wrong = {
        "inwards": -true,
        "of any sign": signs * true,
        "of a part": np.where(top[:, None], -true, true),
        "directions of view": rays[best, np.arange(len(true))],
    }[kind]
    found = oriented_normals(replace(cloud, normals=wrong), ScanOptions())
    assert share_right(found, true) > 0.99
    (note,) = found.provenance[-1].notes
    assert note.startswith(
        "did not use the file's own normals: the flood fill contradicts "
    )
    assert note.endswith("(scan.orientation 'given' uses them)")
    asked = oriented_normals(
        replace(cloud, normals=wrong), ScanOptions(orientation="given")
    )
    assert asked.normals is not None
    np.testing.assert_array_equal(asked.normals, wrong)


@pytest.mark.parametrize(
    "shift", [(0, 0, 0), (9, -20, 0), (5e5, 4e6, 100), (0, 0, 1.5), (0.4, 0, 0)]
)
@pytest.mark.parametrize("name", SURFACES)
def test_a_sensor_that_never_stood_there_is_not_used(
    name: str, shift: tuple[float, float, float]
) -> None:
    """The pose of a scan may be the shift of its coordinates: the points tell."""
    cloud, true = scanned(SURFACES[name])
    placed = replace(cloud, viewpoints=np.array(shift, dtype=float))
    found = oriented_normals(placed, ScanOptions())
    assert share_right(found, true) > 0.99
    assert found.viewpoints is None
    assert "did not use the file's own sensor positions" in found.provenance[-1].notes[-1]
    asked = oriented_normals(placed, ScanOptions(orientation="viewpoint"))
    assert asked.viewpoints is not None and share_right(asked, true) < 0.9


def test_one_view_is_oriented_by_its_sensor_or_its_normals() -> None:
    cloud, true = scanned(SURFACES["body"], 16_000)
    sensor = np.array([0.0, -4.0, 0.5])
    facing = np.einsum("ij,ij->i", sensor - cloud.points, true) > 0.5
    view = PointCloud(cloud.points[facing], viewpoints=sensor)
    found = oriented_normals(view, ScanOptions())
    assert found.viewpoints is not None
    assert share_right(found, true[facing]) > 0.97
    found = oriented_normals(PointCloud(view.points, true[facing]), ScanOptions())
    assert share_right(found, true[facing]) == 1


def test_what_a_scan_does_not_have() -> None:
    cloud, _ = scanned(SURFACES["ball"], 500)
    for method, words in (
        ("given", "with normals, this one has none"),
        ("viewpoint", "sensor positions"),
    ):
        with pytest.raises(ReconstructionError, match=words) as raised:
            oriented_normals(cloud, ScanOptions(orientation=method))
        assert raised.value.stage == "orient"


# A unit that is a power of two changes no digit, however far single precision is from bearing it.
@pytest.mark.parametrize("unit", [2.0**-150, 2.0**-40, 2.0**10, 2.0**70, 2.0**150])
def test_open3d_gives_the_same_in_any_unit(unit: float) -> None:
    normals = SURFACES["ball"].vertices
    for found, expected in (
        (estimate_normals(scale * normals, n_neighbors=20) for scale in (unit, 1.0)),
        (
            orient_by_tangent_planes(scale * normals, normals, n_neighbors=12)
            for scale in (unit, 1.0)
        ),
        (
            feature_histograms(scale * normals, normals, radius=0.3 * scale)
            for scale in (unit, 1.0)
        ),
    ):
        np.testing.assert_array_equal(found, expected)
