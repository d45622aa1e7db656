"""Large holes are closed by minimal surfaces, and those on which the body can stand are its base."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapes

from pcretrieve import process
from pcretrieve.options import ScanOptions, SurfaceOptions
from pcretrieve.points import crop
from pcretrieve.simulation import POSES, RigOptions, body, make_subject, on_support, scan
from pcretrieve.surface import SurfaceMarks, body_surfaces
from pcretrieve.values import FloatArray, PointCloud, TriangleMesh

ONCE = SurfaceOptions(reconstructions=1)
EGG = shapes.ellipsoid((0.6, 0.7, 1.0), subdivisions=4)


def part_of(mesh: TriangleMesh, direction: FloatArray, height: float, n: int = 20_000) -> PointCloud:
    """Points of a surface, without those above a plane."""
    cloud = shapes.oriented_points_on(mesh, n)
    return cloud.select(cloud.points @ direction < height)


def surface(cloud: PointCloud) -> tuple[TriangleMesh, SurfaceMarks]:
    return next(body_surfaces(cloud, ONCE))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_cap_is_in_the_plane_of_its_rim(side: float) -> None:
    """The Poisson surface alone bulges beyond the plane by a tenth of the diagonal."""
    down = np.array([0, 0, side])
    mesh, marks = surface(part_of(EGG, down, 0.7))
    assert (mesh.vertices @ down).max() < 0.75  # the rim, by two voxels
    assert np.median(marks.base @ down) == pytest.approx(0.7, abs=0.01)
    # Of the ellipsoid x² / .36 + y² / .49 + z² = 1 below z = .7.
    assert mesh.volume == pytest.approx(np.pi * 0.6 * 0.7 * (1.7 - (1 + 0.7**3) / 3), rel=0.02)


def test_a_body_cannot_stand_on_the_end_of_a_limb() -> None:
    """A rod that leans out of an egg, beside the mean of the points."""
    rod = shapes.ellipsoid((1.0, 0.2, 0.2), subdivisions=4)
    turn = np.array([[1, 0, -1], [0, np.sqrt(2), 0], [1, 0, 1]]) / np.sqrt(2)
    middle = np.array([0.5, 0, 1.2])
    limb = TriangleMesh(rod.vertices @ turn.T + middle, rod.faces)
    on_egg, on_limb = shapes.oriented_points_on(EGG, 15_000), shapes.oriented_points_on(limb, 6000)
    outwards = np.array([1, 0, 1]) / np.sqrt(2)
    free = ((on_limb.points / [0.6, 0.7, 1.0]) ** 2).sum(axis=1) > 1
    outside = (((on_egg.points - middle) @ turn / [1.0, 0.2, 0.2]) ** 2).sum(axis=1) > 1
    kept = on_limb.select(free & (on_limb.points @ outwards < 1.8))
    assert kept.normals is not None and on_egg.normals is not None
    cloud = PointCloud(
        np.concatenate([on_egg.points[outside], kept.points]),
        normals=np.concatenate([on_egg.normals[outside], kept.normals]),
    )
    mesh, marks = surface(cloud)
    assert (mesh.vertices @ outwards).max() == pytest.approx(1.8, abs=0.05)
    assert not len(marks.base)


@pytest.mark.parametrize("pose", ["reach_up", "sit"])
def test_soles_and_a_seat_that_were_not_seen_are_closed_flat(pose: str) -> None:
    """Bulges under the soles had a tenth of the area of the body, and no flood fill reached between limbs."""
    person = body(make_subject("person", np.random.default_rng(2)), POSES["person"][pose])
    rig = RigOptions(n_points=30_000)
    whole = scan(person, rig, np.random.default_rng(3))
    unseen = on_support(person, whole.points, seated=pose == "sit")
    assert 0.005 < unseen.mean() < 0.1
    shape = process(whole.select(~unseen), {"surface": {"reconstructions": 1}})
    assert shape.mesh.area == pytest.approx(person.area, rel=0.04)
    assert shape.mesh.vertices[:, 1].min() > person.vertices[:, 1].min() - 0.01 * person.diagonal
    assert shape.verdict is not None
    assert any("closed base" in reason for reason in shape.verdict.reasons), shape.verdict
    assert shape.verdict.judgement == "doubtful"


def test_on_a_scanned_ground_a_base_is_no_fault() -> None:
    rng = np.random.default_rng(0)
    egg = part_of(EGG, np.array([0, 0, -1.0]), 0.7, 60_000)
    floor = np.column_stack([rng.uniform(-1.5, 1.5, (24_000, 2)), np.full(24_000, -0.7)])
    floor = floor[((floor / [0.6, 0.7, 1.0]) ** 2).sum(axis=1) > 1]
    points = np.concatenate([egg.points, floor])
    eye = points * [10, 10, 0] + np.array([0, 0, 2.0])
    scanned = PointCloud(points, viewpoints=eye)
    up = crop(scanned, ScanOptions()).up
    assert up is not None
    np.testing.assert_allclose(up, [0, 0, 1], atol=0.01)
    assert replace(scanned, provenance=()).up is None
    shape = process(scanned, {"surface": {"reconstructions": 1}})
    alone = process(PointCloud(egg.points), {"surface": {"reconstructions": 1}})
    assert shape.verdict is not None and alone.verdict is not None
    assert alone.mesh.area == pytest.approx(shape.mesh.area, rel=0.02)
    assert any("closed base" in reason for reason in alone.verdict.reasons)
    assert shape.verdict.uncertainty < alone.verdict.uncertainty - 0.1
