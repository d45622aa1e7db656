"""Canonical forms: distances in space that are those on the surface."""

from __future__ import annotations

import numpy as np
import pytest
import shapes
from scipy.spatial.distance import cdist, pdist

from pcretrieve.errors import DegenerateMeshError
from pcretrieve.matching.cm_bof import N_FACES, canonical_form, geodesic_distances, scaled_coordinates
from pcretrieve.values import TriangleMesh


def test_paths_on_a_sphere_are_near_the_great_circles() -> None:
    mesh = shapes.icosphere(3)
    exact = np.arccos(np.clip(mesh.vertices @ mesh.vertices.T, -1, 1))
    ratios = geodesic_distances(mesh)[exact > 0.5] / exact[exact > 0.5]
    assert 0.99 < ratios.min() < ratios.max() < 1.08
    assert ratios.mean() < 1.04


def test_points_in_space_are_found_from_their_distances() -> None:
    points = np.random.default_rng(0).normal(size=(40, 3))
    distances = cdist(points, points)
    made = scaled_coordinates(distances)
    np.testing.assert_allclose(cdist(made, made), distances, atol=1e-8)


def bent(angle: float) -> TriangleMesh:
    """A rod, 6 long, that is bent by an angle in its middle part without much stretching."""
    rod = shapes.ellipsoid((0.3, 0.25, 3), subdivisions=2)
    x, y, z = rod.vertices.T
    turn = np.clip(z / 2, -0.5, 0.5) * angle
    if angle == 0:
        return rod
    radius = 2 / angle
    rest = z - np.clip(z, -1, 1)
    vertices = np.column_stack(
        [
            radius - (radius - x) * np.cos(turn) + rest * np.sin(turn),
            y,
            (radius - x) * np.sin(turn) + rest * np.cos(turn),
        ]
    )
    return TriangleMesh(vertices, rod.faces)


def test_a_bent_rod_becomes_straight() -> None:
    assert np.ptp(bent(2.0).vertices, axis=0).max() < 5.2, "the rod is bent"
    straight, straightened = (canonical_form(bent(angle)) for angle in (0.0, 2.0))
    assert np.ptp(straightened.vertices, axis=0)[0] == pytest.approx(2, abs=0.1)
    difference = pdist(straight.vertices) - pdist(straightened.vertices)
    assert np.abs(difference).max() < 0.25
    assert np.abs(difference).mean() < 0.08


def test_the_form_has_a_pose_a_size_and_a_side() -> None:
    mesh = shapes.body(4)
    assert len(mesh.faces) > N_FACES
    form = canonical_form(mesh)
    assert len(form.faces) == N_FACES
    assert np.linalg.norm(form.vertices, axis=1).max() == pytest.approx(1)
    middles = form.vertices[form.faces].mean(axis=1)
    np.testing.assert_allclose(form.face_areas @ middles, 0, atol=1e-12)
    assert form.volume > 0
    mirrored = TriangleMesh(mesh.vertices * [-1, 1, 1], mesh.faces[:, ::-1])
    assert canonical_form(mirrored).volume > 0


@pytest.mark.parametrize(
    ("mesh", "message"),
    [
        (shapes.joined(shapes.icosphere(1), shapes.moved(shapes.icosphere(1), 1)), "a connected surface"),
        (TriangleMesh(np.eye(3), np.array([[0, 1, 2]])), "at least 4 vertices, got 3"),
        (TriangleMesh(np.zeros((4, 3)), shapes.TETRAHEDRON_FACES), "no face of 4 has an area"),
    ],
    ids=["components", "triangle", "point"],
)
def test_surfaces_without_a_form_are_named(mesh: TriangleMesh, message: str) -> None:
    with pytest.raises(DegenerateMeshError, match=message):
        canonical_form(mesh)
