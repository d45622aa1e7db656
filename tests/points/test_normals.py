"""Normals point out of the body, with every method of orientation, in every unit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapes

from pcretrieve.errors import ReconstructionError
from pcretrieve.options import ScanOptions
from pcretrieve.points import oriented_normals
from pcretrieve.points.normals import estimate_normals, orient_by_tangent_planes
from pcretrieve.points.register.groups import feature_histograms
from pcretrieve.values import FloatArray, PointCloud, TriangleMesh

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
    assert share_right(oriented_normals(cloud, ScanOptions(orientation=method)), true) > 0.99


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


def test_auto_prefers_sensors_to_normals_and_normals_to_a_flood_fill() -> None:
    cloud, true = scanned(SURFACES["torus"])
    wrong = replace(cloud, normals=-true)
    assert share_right(oriented_normals(cloud, ScanOptions()), true) > 0.99
    given = oriented_normals(wrong, ScanOptions())
    assert share_right(given, true) == 0
    assert given.provenance[-1].notes == ("used the file's own normals",)
    # The inner side of the torus too has a sensor that sees it.
    seen = replace(wrong, viewpoints=cloud.points + 0.1 * true)
    assert share_right(oriented_normals(seen, ScanOptions()), true) == 1


def test_what_a_scan_does_not_have() -> None:
    cloud, _ = scanned(SURFACES["ball"], 500)
    for method, words in (("given", "with normals, this one has none"), ("viewpoint", "sensor positions")):
        with pytest.raises(ReconstructionError, match=words) as raised:
            oriented_normals(cloud, ScanOptions(orientation=method))
        assert raised.value.stage == "orient"


# A unit that is a power of two changes no digit, however far single precision is from bearing it.
@pytest.mark.parametrize("unit", [2.0**-150, 2.0**-40, 2.0**10, 2.0**70, 2.0**150])
def test_open3d_gives_the_same_in_any_unit(unit: float) -> None:
    normals = SURFACES["ball"].vertices
    for found, expected in (
        (estimate_normals(scale * normals, n_neighbors=20) for scale in (unit, 1.0)),
        (orient_by_tangent_planes(scale * normals, normals, n_neighbors=12) for scale in (unit, 1.0)),
        (feature_histograms(scale * normals, normals, radius=0.3 * scale) for scale in (unit, 1.0)),
    ):
        np.testing.assert_array_equal(found, expected)
