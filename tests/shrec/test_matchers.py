"""Matchers rank as any other source of distances; what each is made of, by surfaces that are known."""

from __future__ import annotations

import logging
import pickle
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
import shapes
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial.distance import cdist, pdist

from pcretrieve.errors import DegenerateMeshError
from pcretrieve.retrieval import DistanceMatrix
from pcretrieve.shrec.cm_bof import (
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
from pcretrieve.shrec.heat import HeatPoints, heat_distance, heat_points, word_frequencies
from pcretrieve.shrec.matcher import MATCHERS, Matcher, match_all
from pcretrieve.shrec.meshsift import (
    _warn_once,
    keypoints,
    levels,
    match_distance,
    mesh_features,
)
from pcretrieve.values import Shape, Surface, TriangleMesh

BALL = shapes.icosphere(4)


def bumpy(seed: int) -> TriangleMesh:
    """A ball with sixty bumps and pits at random places."""
    rng = np.random.default_rng(seed)
    centres = rng.normal(size=(60, 3))
    centres /= np.linalg.norm(centres, axis=1, keepdims=True)
    angles = np.arccos(np.clip(BALL.vertices @ centres.T, -1, 1))
    radius = 1 + np.exp(-((angles / 0.13) ** 2) / 2) @ rng.uniform(-0.08, 0.12, 60)
    return TriangleMesh(BALL.vertices * radius[:, np.newaxis], BALL.faces)


BUMPY = bumpy(0)


# --- laws of all matchers -------------------------------------------------------------------------------

EGG, LONG = (shapes.ellipsoid((1, 1, length), subdivisions=3) for length in (1.5, 3.0))

# A surface, one that is unlike it, and how much nearer than that one a copy of the first must be.
SURFACES = {
    "heat-hausdorff": (EGG, LONG, 0.02),
    "hks-bow-gallery": (EGG, LONG, 0.02),
    "mds-cm-bof": (shapes.body(2), shapes.ellipsoid((1, 0.6, 0.4), subdivisions=3), 0.3),
    "meshsift": (BUMPY, bumpy(1), 0.15),
}


@pytest.mark.parametrize("name", MATCHERS)
def test_a_moved_scaled_and_renumbered_surface_is_near(name: str) -> None:
    if name == "mds-cm-bof":
        pytest.importorskip("cv2", reason="SIFT comes from OpenCV")
    matcher, (mesh, other, nearness) = MATCHERS[name], SURFACES[name]
    meshes = (mesh, mesh, other, shapes.renumbered(shapes.moved(mesh, 1, scale=7), 2))
    described = [matcher.prepare(shapes.shape(each)) for each in meshes]
    assert pickle.dumps(described[0]) == pickle.dumps(described[1])
    if matcher.learn is not None:
        learned = pickle.loads(pickle.dumps(matcher.learn(described[1:3])))
        described = [learned(each) for each in described]
    made, again, unlike, moved = described
    far = matcher.distance(made, unlike)
    assert far == pytest.approx(matcher.distance(unlike, made))
    assert matcher.distance(made, again) <= nearness * far
    assert matcher.distance(made, moved) < nearness * far


def lacking(query: float, other: float) -> float:
    """What a query is larger by: no distance from large shapes to small ones alone."""
    return max(0.0, query - other)


def apart(query: float, other: float) -> float:
    return abs(query - other)


AREAS = {"c": 1.0, "a": 2.0, "b": 1.5, "d": 1.5}
LACKING = Matcher("lacking", lambda shape: shape.area, lacking, needs=(), symmetric=False)


def matched(matcher: Matcher) -> DistanceMatrix:
    found = match_all(matcher, AREAS, lambda name: Shape((Surface(AREAS[name]),)))
    return DistanceMatrix(*found)


def test_each_distance_is_that_of_the_matcher_from_the_query() -> None:
    """Of a symmetric distance, half are computed."""
    size = [*AREAS.values()]
    matrix = matched(LACKING)
    assert matrix.ids == ("c", "a", "b", "d")
    np.testing.assert_array_equal(
        matrix.values, [[lacking(one, two) for two in size] for one in size]
    )
    calls = []

    def counted(query: float, other: float) -> float:
        calls.append((query, other))
        return apart(query, other)

    matrix = matched(replace(LACKING, distance=counted, symmetric=True))
    assert len(calls) == 4 + 3 + 2 + 1
    np.testing.assert_array_equal(
        matrix.values, [[apart(one, two) for two in size] for one in size]
    )


def test_a_shape_that_a_matcher_fails_on_is_left_out(
    caplog: pytest.LogCaptureFixture,
) -> None:
    def clumsy(shape: Shape) -> float:
        if shape.area == 2:
            raise IndexError("list index out of range")
        return shape.area

    assert matched(replace(LACKING, prepare=clumsy)).ids == ("c", "b", "d")
    message = "the matcher 'lacking' failed, IndexError: list index out of range"
    assert caplog.messages == [f"left out a: {message}"]


def test_distances_are_those_of_what_all_shapes_taught() -> None:
    def relative(gallery: Sequence[float]) -> Callable[[float], float]:
        largest = max(gallery)
        return lambda area: area / largest

    assert matched(replace(LACKING, distance=apart, learn=relative)).values[
        1
    ] == pytest.approx([0.5, 0, 0.25, 0.25])


def test_surfaces_without_features_are_named() -> None:
    flat = TriangleMesh(np.zeros((4, 3)), shapes.TETRAHEDRON_FACES)
    two = shapes.joined(shapes.icosphere(1), shapes.moved(shapes.icosphere(1), 1))
    triangle = TriangleMesh(np.eye(3), np.array([[0, 1, 2]]))
    for mesh, message in (
        (two, "a connected surface"),
        (triangle, "at least 4 vertices, got 3"),
    ):
        with pytest.raises(DegenerateMeshError, match=message):
            canonical_form(mesh)
    with pytest.raises(DegenerateMeshError, match="no keypoints"):
        mesh_features(shapes.shape(shapes.tetrahedron()))
    for refused in (canonical_form, lambda mesh: mesh_features(shapes.shape(mesh))):
        with pytest.raises(DegenerateMeshError, match="no face of 4 has an area"):
            refused(flat)


# --- heat kernel signatures -----------------------------------------------------------------------------


def test_the_distance_is_the_larger_mean_of_smallest_distances() -> None:
    rng = np.random.default_rng(0)
    one, two = rng.normal(size=(7, 6)), rng.normal(size=(5, 6)) + 1
    sets = [
        HeatPoints(features, np.full(len(features), 1 / len(features)))
        for features in (one, two)
    ]
    gaps = np.linalg.norm(one[:, np.newaxis] - two, axis=2)
    expected = max(gaps.min(axis=1).mean(), gaps.min(axis=0).mean())
    assert heat_distance(*sets) == heat_distance(*sets[::-1]) == pytest.approx(expected)
    assert heat_distance(sets[0], sets[0]) == 0


def test_words_of_a_gallery_are_shares_of_the_surface() -> None:
    features = [heat_points(shapes.shape(mesh)) for mesh in (EGG, LONG)]
    for frequencies in map(word_frequencies(features), features):
        assert frequencies.shape == (48,)
        assert frequencies.sum() == pytest.approx(1)
        assert (frequencies >= 0).all()


# --- MDS-CM-BOF -----------------------------------------------------------------------------------------


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


def test_a_bent_rod_becomes_straight() -> None:
    rod = shapes.ellipsoid((0.3, 0.25, 3), subdivisions=2)
    x, y, z = rod.vertices.T
    # Round a middle of radius 1, without much stretching.
    turn, rest = np.clip(z, -1, 1), z - np.clip(z, -1, 1)
    across = 1 - (1 - x) * np.cos(turn) + rest * np.sin(turn)
    along = (1 - x) * np.sin(turn) + rest * np.cos(turn)
    bent = TriangleMesh(np.column_stack([across, y, along]), rod.faces)
    assert np.ptp(bent.vertices, axis=0).max() < 5.2, "the rod is bent"
    straight, straightened = canonical_form(rod), canonical_form(bent)
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
    return csr_array(histograms.astype(np.float64))


def test_the_best_position_counts() -> None:
    rng = np.random.default_rng(0)
    one, two = (
        rng.poisson(0.2, (66, 30)) * (rng.random((66, 1)) < 0.9) for _ in range(2)
    )
    means = []
    for row in exchanges():
        common = np.minimum(one[row], two).sum(axis=1)
        larger = np.maximum(one[row].sum(axis=1), two.sum(axis=1))
        means.append(np.mean(np.where(larger > 0, 1 - common / np.maximum(larger, 1), 0)))
    assert clock_distance(words_of(one), words_of(two)) == pytest.approx(min(means))
    assert clock_distance(words_of(one[exchanges()[7]]), words_of(one)) == 0
    nothing = words_of(np.zeros((66, 30), dtype=int))
    assert clock_distance(nothing, nothing) == 0
    assert clock_distance(words_of(np.ones((66, 30), dtype=int)), nothing) == 1


# --- meshSIFT -------------------------------------------------------------------------------------------


def test_curvatures_of_a_ball_and_of_a_ring() -> None:
    ball = levels(shapes.icosphere(4, radius=2.0))[0]
    # Smoothing moves the twelve vertices with five neighbours more than the others.
    np.testing.assert_allclose(np.median(ball.curvatures, axis=0), 0.5, rtol=0.02)
    ring = shapes.torus(96, 48)
    made = levels(ring)[0].curvatures
    np.testing.assert_allclose(made[:, 0], 1 / 0.4, rtol=0.05)  # around the tube
    outside = np.linalg.norm(ring.vertices[:, :2], axis=1) > 1.39
    np.testing.assert_allclose(made[outside, 1], 1 / 1.4, rtol=0.05)


def test_a_bump_on_a_ball_is_the_only_keypoint() -> None:
    angles = np.arccos(np.clip(BALL.vertices @ BALL.vertices[200], -1, 1))
    bump = 1 + 0.1 * np.exp(-((angles / 0.12) ** 2) / 2)
    mesh = TriangleMesh(BALL.vertices * bump[:, np.newaxis], BALL.faces)
    (vertex,), _ = keypoints(levels(mesh), mesh, 99)
    assert angles[vertex] < 0.1
    assert not len(keypoints(levels(BALL), BALL, 99)[0])


def test_a_noisy_surface_matches() -> None:
    noise = np.random.default_rng(0).normal(scale=0.002, size=BUMPY.vertices.shape)
    noisy = TriangleMesh(BUMPY.vertices + noise, BUMPY.faces)
    made, near, far = (
        mesh_features(shapes.shape(mesh)) for mesh in (BUMPY, noisy, bumpy(1))
    )
    assert match_distance(made, near) < 0.3 < 0.7 < match_distance(made, far)


def test_a_match_is_clearly_nearer_than_the_second() -> None:
    one, two = (
        np.column_stack([np.cos(angles), np.sin(angles)]).astype(np.float32)
        for angles in (np.array([0.0, 0.5, 2.0]), np.array([0.1, 0.6, 1.25]))
    )
    # From one: .1 of .6, .1 of .4, .75 of 1.4. From two: .1 of .4, .1 of .6; the nearest of the third, .65 of
    # .75, is not mutual, nor clear.
    assert match_distance(one, two) == pytest.approx(1 - (2 + 2) / 2 / 3)
    assert match_distance(one, two[:2]) == pytest.approx(1 - 2 / 3), (
        "by the larger number of features"
    )
    assert match_distance(one, two[:1]) == pytest.approx(1 - 1 / 2 / 3)


def test_coarse_surfaces_are_warned_of_once(caplog: pytest.LogCaptureFixture) -> None:
    _warn_once.cache_clear()
    with caplog.at_level(logging.WARNING, logger="pcretrieve"):
        mesh_features(shapes.shape(BUMPY))
        assert not caplog.records
        for _ in range(2):
            mesh_features(shapes.shape(shapes.body(3)))
    (record,) = caplog.records
    assert "meshsift needs surfaces of at least 5000 faces" in record.getMessage()
