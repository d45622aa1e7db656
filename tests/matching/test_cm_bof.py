"""MDS-CM-BOF: distances in space that are those on the surface, views, and the best of 24 positions."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import shapes
from numpy.typing import NDArray
from scipy.spatial.distance import cdist, pdist

from pcretrieve.errors import DegenerateMeshError
from pcretrieve.matching import MATCHERS
from pcretrieve.matching.cm_bof import (
    N_FACES,
    N_PIXELS,
    ViewWords,
    canonical_form,
    clock_distance,
    depth_pictures,
    directions,
    exchanges,
    geodesic_distances,
    scaled_coordinates,
)
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
    across = radius - (radius - x) * np.cos(turn) + rest * np.sin(turn)
    along = (radius - x) * np.sin(turn) + rest * np.cos(turn)
    return TriangleMesh(np.column_stack([across, y, along]), rod.faces)


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


def test_surfaces_without_a_form_are_named() -> None:
    for mesh, message in (
        (shapes.joined(shapes.icosphere(1), shapes.moved(shapes.icosphere(1), 1)), "a connected surface"),
        (TriangleMesh(np.eye(3), np.array([[0, 1, 2]])), "at least 4 vertices, got 3"),
        (TriangleMesh(np.zeros((4, 3)), shapes.TETRAHEDRON_FACES), "no face of 4 has an area"),
    ):
        with pytest.raises(DegenerateMeshError, match=message):
            canonical_form(mesh)


def test_rotations_exchange_the_directions() -> None:
    rows = exchanges()
    assert rows.shape == (24, 66)
    assert len({tuple(row) for row in rows.tolist()}) == 24
    assert np.arange(66).tolist() in rows.tolist()
    gram = directions() @ directions().T
    for row in rows:
        np.testing.assert_allclose(gram[np.ix_(row, row)], gram, atol=1e-12)


def test_pictures_show_the_depth_of_a_ball() -> None:
    ball = shapes.icosphere(5, radius=0.8)
    pictures = np.array(list(depth_pictures(ball)))
    assert pictures.shape == (66, N_PIXELS, N_PIXELS)
    x = (np.arange(N_PIXELS) - (N_PIXELS - 1) / 2) / (0.95 * (N_PIXELS - 1) / 2)
    squares = x**2 + x[:, np.newaxis] ** 2
    depth = np.where(squares < 0.6, (1 + np.sqrt(np.maximum(0.64 - squares, 0))) / 2, 0)
    inner, outside = squares < 0.55, squares > 0.65
    assert np.abs(pictures[:, inner] - depth[inner]).max() < 2e-3
    assert (pictures[:, outside] == 0).all()


def words_of(histograms: NDArray[np.int64]) -> ViewWords:
    """The words of (66, W) histograms."""
    rows, words = np.nonzero(histograms)
    starts = np.searchsorted(rows, np.arange(67))
    return ViewWords(*(part.astype(np.int32) for part in (starts, words, histograms[rows, words])))


def test_the_best_position_counts() -> None:
    rng = np.random.default_rng(0)
    one, two = (rng.poisson(0.2, (66, 30)) * (rng.random((66, 1)) < 0.9) for _ in range(2))
    means = []
    for row in exchanges():
        common = np.minimum(one[row], two).sum(axis=1)
        larger = np.maximum(one[row].sum(axis=1), two.sum(axis=1))
        means.append(np.mean(np.where(larger > 0, 1 - common / np.maximum(larger, 1), 0)))
    assert clock_distance(words_of(one), words_of(two)) == pytest.approx(min(means))
    assert clock_distance(words_of(two), words_of(one)) == pytest.approx(min(means))
    assert clock_distance(words_of(one[exchanges()[7]]), words_of(one)) == 0
    nothing = words_of(np.zeros((66, 30), dtype=int))
    assert clock_distance(nothing, nothing) == 0
    assert clock_distance(words_of(np.ones((66, 30), dtype=int)), nothing) == 1


def test_moved_scaled_and_renumbered_surfaces_are_near() -> None:
    pytest.importorskip("cv2", reason="SIFT comes from OpenCV")
    match = MATCHERS["mds-cm-bof"]
    mesh, other = shapes.body(2), shapes.ellipsoid((1, 0.6, 0.4), subdivisions=3)
    meshes = (mesh, mesh, other, shapes.renumbered(shapes.moved(mesh, 1, scale=7), 2))
    described = [match.prepare(shapes.shape(each)) for each in meshes]
    for one, two in zip(described[0], described[1], strict=True):
        np.testing.assert_array_equal(one, two)
    assert match.learn is not None
    counted = pickle.loads(pickle.dumps(match.learn(described[:3])))
    made, again, unlike, moved = map(counted, described)
    assert match.distance(made, again) == 0
    assert match.distance(made, moved) < 0.2 < 0.7 < match.distance(made, unlike)
