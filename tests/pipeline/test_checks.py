"""Each check of points and surface has a drawn case that trips it, and one that does not.

A ball, a ball with a hole, a ball whose one side is thin, a tube that was cut off, two layers of points, two
balls that touch, and a person without a limb.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import trimesh
from benchmarks.bodies import Body, Mask, standing_places
from benchmarks.sensors import SENSORS, left_by
from benchmarks.simulation.bodies import POSES, body, make_subject
from benchmarks.solids import machine_part
from benchmarks.uniform import BODIES, points_of
from shapes import icosphere
from trimesh.remesh import subdivide, subdivide_to_size

from pcretrieve import PointCloud, TriangleMesh
from pcretrieve.checks import Check, findings_of
from pcretrieve.checks.findings import N_NEIGHBORS, parts_at
from pcretrieve.checks.fit import Fit, parts
from pcretrieve.checks.grading import ENDS_OF_NOISE
from pcretrieve.checks.layers import double_layers
from pcretrieve.checks.stages import (
    N_FACES,
    body_check,
    ends_check,
    hole_check,
    limbs_check,
    neck,
)
from pcretrieve.draw.axes import person_of
from pcretrieve.pipeline.process import judged_signature, process
from pcretrieve.points.neighbors import neighborhoods
from pcretrieve.retrieval import limbless_ratio
from pcretrieve.spectral import unit_eigenpairs
from pcretrieve.surface.marching import level_set
from pcretrieve.surface.reconstruct import uniform_points
from pcretrieve.values import FloatArray, unit_vectors

BALL = icosphere(4)


def on_ball(n: int = 20_000) -> FloatArray:
    """(n, 3) random points of the unit sphere."""
    points = np.random.default_rng(0).standard_normal((n, 3))
    return np.asarray(points / np.linalg.norm(points, axis=1, keepdims=True))


def cloud_of(points: FloatArray, normals: FloatArray | None = None) -> PointCloud:
    """Points of a ball, whose normals are radial, or points with normals."""
    return PointCloud(points, normals=points if normals is None else normals)


def checks_of(
    cloud: PointCloud, mesh: TriangleMesh, scan: PointCloud | None = None
) -> dict[str, Check]:
    """The checks by their names."""
    return {
        check.name: check
        for check in findings_of(cloud, mesh, None, None, scan=scan).checks
    }


def fit_of(cloud: PointCloud, mesh: TriangleMesh) -> Fit:
    """How points that are the scan, too, and a surface lie to each other."""
    around = neighborhoods(cloud.points, N_NEIGHBORS + 1, of_some=True)
    return Fit(cloud, around, mesh, cloud)


def test_a_ball_passes() -> None:
    found = checks_of(cloud_of(on_ball()), BALL)
    assert {check.name for check in found.values() if check.outcome != "passed"} == set()


def test_a_hole_in_a_ball_shows_at_its_place() -> None:
    points = on_ball()
    pierced = points[np.linalg.norm(points - [0, 0, 1], axis=1) > 0.2]
    found = checks_of(cloud_of(pierced), BALL)["Largest hole"]
    assert (found.outcome, found.grade) == ("failed", "incomplete")
    assert np.linalg.norm(np.array(found.places) - [0, 0, 1]) < 0.05


@pytest.mark.parametrize(("share", "outcome"), [(1.0, "failed"), (0.4, "passed")])
def test_a_hole_in_the_shade_shows_if_the_sensor_sees_into_shades(
    share: float, outcome: str
) -> None:
    # A ball with a groove all round, in which a share of the points is.
    ball = icosphere(5)
    depth = 0.5 * np.exp(-((ball.vertices[:, 2:] / 0.2) ** 2))
    grooved = TriangleMesh(ball.vertices * (1 - depth), ball.faces)
    points, faces = uniform_points(grooved, 40_000, np.random.default_rng(0))
    normals = grooved.area_vectors[faces] / grooved.face_areas[faces, np.newaxis]
    is_seen = np.random.default_rng(1).random(len(points)) < share
    kept = np.linalg.norm(points - [0.5, 0, 0], axis=1) > 0.1
    kept &= is_seen | (np.abs(points[:, 2]) > 0.2)
    fit = fit_of(cloud_of(points[kept], normals[kept]), grooved)
    assert fit.holes[0].light < 0.6
    assert hole_check(fit).outcome == outcome


def test_the_radius_of_a_hole_is_measured_between_the_vertices() -> None:
    points = on_ball(60_000)
    pierced = points[np.linalg.norm(points - [0.3, 0.5, 0.81], axis=1) > 0.2]
    (hole,) = fit_of(cloud_of(pierced), icosphere(3)).holes
    assert hole.radius == pytest.approx(0.1, rel=0.08)  # of the diameter


def test_small_holes_alone_are_none() -> None:
    points, ball = on_ball(200_000), icosphere(5)
    middle = ball.vertices[ball.faces[0]].mean(axis=0)
    fit = fit_of(cloud_of(points[np.linalg.norm(points - middle, axis=1) > 0.027]), ball)
    assert len(fit.far) > 0
    assert fit.holes == ()


def by_turntable(points: FloatArray, normals: FloatArray) -> Mask:
    """(n,) whether a camera beside a turntable with the axis z measures points: seldom at a grazing angle."""
    beside = np.sqrt(1 - normals[:, 2] ** 2).clip(0)
    return np.asarray(np.random.default_rng(1).random(len(points)) < beside**2)


def test_holes_above_and_below_are_expected_of_a_turntable() -> None:
    points = on_ball(200_000)
    points = points[by_turntable(points, points)]
    seen = points[np.abs(points[:, 2]) < 0.97]
    fit = fit_of(cloud_of(seen), BALL)
    assert [hole.is_expected for hole in fit.holes if hole.radius > 0.05] == [True, True]
    assert hole_check(fit).outcome == "passed"
    and_one_beside = seen[np.linalg.norm(seen - [1, 0, 0], axis=1) > 0.2]
    fit = fit_of(cloud_of(and_one_beside), BALL)
    assert hole_check(fit).outcome == "failed"


def test_a_hole_above_shows_if_sensors_stood_on_all_sides() -> None:
    points = on_ball(80_000)
    fit = fit_of(cloud_of(points[points[:, 2] < 0.97]), BALL)
    assert [hole.is_expected for hole in fit.holes] == [False]


def test_a_direction_is_unseen_if_other_surface_that_faces_it_is() -> None:
    points = on_ball(200_000)
    for kept, is_unseen in ((by_turntable(points, points), True), (slice(None), False)):
        fit = fit_of(cloud_of(points[kept][:80_000]), BALL)
        for axis, expected in ((2, is_unseen), (0, False)):
            place = np.eye(3)[axis]
            faces = np.array([np.linalg.norm(fit.middles - place, axis=1).argmin()])
            assert fit.is_unseen(faces, place, 0.2) == expected


def test_a_thin_side_is_uneven_however_dense_the_other_is() -> None:
    points = on_ball(200_000)
    thin = points[
        (points[:, 0] > 0) | (np.random.default_rng(1).random(len(points)) < 0.1)
    ]
    found = checks_of(cloud_of(on_ball()), BALL, PointCloud(thin))["Evenness"]
    assert (found.outcome, found.grade) == ("failed", "incomplete")
    assert found.value == pytest.approx(10**0.5, rel=0.1)


def capsule(n: int = 20_000) -> tuple[FloatArray, FloatArray]:
    """Points of a capsule along x, and their normals."""
    points = points_of(BODIES["capsule"], n, np.random.default_rng(0))
    axis = np.clip(points, [-0.8, 0, 0], [0.8, 0, 0])
    normals = points - axis
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def tube(end: float) -> TriangleMesh:
    """A capsule along x whose right end is flat, at x = end."""
    vertices = BALL.vertices * 0.35
    vertices = (
        vertices
        + [0.8, 0, 0] * np.sign(vertices[:, :1]) * np.abs(BALL.vertices[:, :1]) ** 0.2
    )
    return TriangleMesh(np.minimum(vertices, [end, 9, 9]), BALL.faces)


def test_a_tube_that_was_cut_off_has_an_end() -> None:
    points, normals = capsule()
    kept = points[:, 0] < 0.5
    fit = fit_of(cloud_of(points[kept], normals[kept]), tube(0.5))
    assert fit.ends[0].size > 0.04
    assert fit.ends[0].middle == pytest.approx([0.5, 0, 0], abs=0.1)


def test_one_cut_that_is_closed_in_two_pieces_is_one_end() -> None:
    slim = np.array([1, 0.2, 0.2])
    points, normals = capsule()
    kept = points[:, 0] < 0.5
    # Points across the cap part what closes it.
    across = np.column_stack(
        [np.full(200, 0.5), np.zeros(200), np.linspace(-0.35, 0.35, 200)]
    )
    aside = np.tile([[0, 1.0, 0], [0, -1, 0]], (100, 1))
    sides = normals[kept] / slim
    sides /= np.linalg.norm(sides, axis=1, keepdims=True)
    cloud = cloud_of(
        slim * np.concatenate([points[kept], across]), np.concatenate([sides, aside])
    )
    cap = tube(0.5)
    fit = fit_of(cloud, TriangleMesh(slim * cap.vertices, cap.faces))
    far, _, is_closing = fit._closing
    assert len(parts(fit.mesh, far[is_closing])) > 1
    assert len(fit.ends) == 1


def test_a_tube_with_its_end_has_none() -> None:
    points, normals = capsule()
    fit = fit_of(cloud_of(points, normals), tube(9.0))
    assert sum(end.size for end in fit.ends) < 2e-3


@pytest.mark.parametrize(("top", "is_end"), [(0.0, True), (0.6, False)])
def test_a_crown_that_is_closed_flat_is_no_end_of_a_limb(
    top: float, is_end: bool
) -> None:
    """Normals round it tilt towards its axis, unlike those of half a ball."""
    points = on_ball(40_000)
    seen = points[points[:, 2] < top]
    closed = TriangleMesh(np.minimum(BALL.vertices, [9, 9, top]), BALL.faces)
    ends = fit_of(cloud_of(seen, seen), closed).ends
    assert (max((end.size for end in ends), default=0.0) > ENDS_OF_NOISE) == is_end


def from_above(points: FloatArray, normals: FloatArray) -> Mask:
    """(n,) whether cameras that see little of what faces down measure points."""
    is_lucky = np.random.default_rng(1).random(len(points)) < 0.55
    return np.asarray((normals[:, 2] > -0.7) | is_lucky)


def on_legs(*ends: float) -> tuple[PointCloud, TriangleMesh]:
    """A ball on slim legs that end so far below its middle, without points of the soles."""
    rng = np.random.default_rng(3)
    points = [on_ball(150_000)]
    normals, vertices, faces = [*points], [BALL.vertices], [BALL.faces]
    for side, end in zip((-0.3, 0.3), ends, strict=True):
        n = round(1800 * (end - 0.9))
        angle, zeros = rng.uniform(0, 2 * np.pi, n), np.zeros(n)
        round_leg = np.stack([np.cos(angle), np.sin(angle), zeros], axis=1)
        middle = np.stack([zeros + side, zeros, -rng.uniform(0.9, end, n)], axis=1)
        points.append(0.03 * round_leg + middle)
        normals.append(round_leg)
        leg = trimesh.creation.cylinder(
            0.03, segment=[[side, 0, -0.9], [side, 0, -end]], sections=32
        )
        place, corners = subdivide_to_size(leg.vertices, leg.faces, 0.02)  # type: ignore[no-untyped-call]
        faces.append(corners + sum(map(len, vertices)))
        vertices.append(place)
    mesh = TriangleMesh(np.concatenate(vertices), np.concatenate(faces))
    return cloud_of(np.concatenate(points), np.concatenate(normals)), mesh


@pytest.mark.parametrize("sees", [by_turntable, from_above])
def test_soles_are_no_ends_but_a_leg_that_ends_above_the_other_is(
    sees: Callable[[FloatArray, FloatArray], Mask],
) -> None:
    for left, n_ends in ((1.5, 0), (1.2, 1)):
        cloud, mesh = on_legs(left, 1.5)
        kept = sees(cloud.points, np.asarray(cloud.normals))
        seen = cloud_of(cloud.points[kept], np.asarray(cloud.normals)[kept])
        ends = [end for end in fit_of(seen, mesh).ends if end.size > ENDS_OF_NOISE]
        assert len(ends) == n_ends
        for end in ends:
            assert end.middle == pytest.approx([-0.3, 0, -left], abs=0.02)


def test_a_wide_cut_that_a_turntable_hides_is_no_sole() -> None:
    # Half of a body that becomes wider towards its cut, on which it stands.
    low = np.maximum(BALL.vertices * [0.35, 0.35, 1], [-9, -9, -0.75])
    wider = 1 + 0.8 * (np.clip(-low[:, 2:] - 0.3, 0, 1) / 0.45) ** 2
    mesh = TriangleMesh(low * np.hstack([wider, wider, np.ones_like(wider)]), BALL.faces)
    points, face = uniform_points(mesh, 60_000, np.random.default_rng(0))
    normals = unit_vectors(mesh.area_vectors[face])
    kept = by_turntable(points, normals) & (normals[:, 2] > -0.9)
    ends = fit_of(cloud_of(points[kept], normals[kept]), mesh).ends
    assert max((end.size for end in ends), default=0.0) > ENDS_OF_NOISE


def test_two_layers_of_points_are_double_walls() -> None:
    rng = np.random.default_rng(2)
    points = on_ball(30_000)
    layers = points * (1 + 0.02 * (rng.random(len(points)) < 0.5))[:, np.newaxis]
    layers += rng.normal(0, 0.001, layers.shape)
    assert (double_layers(cloud_of(layers, points)).apart > 0).mean() > 0.5
    assert (double_layers(cloud_of(points)).apart > 0).mean() < 0.03


def one_body(mesh: TriangleMesh) -> Check:
    """The check whether a surface is one body."""
    eigenvectors = unit_eigenpairs(mesh, 61).eigenvectors
    return body_check(neck(mesh, eigenvectors[:, 1:]))


def about_origin(radius: FloatArray) -> TriangleMesh:
    """A surface by its radius in the directions of the vertices of a ball, (n,)."""
    return TriangleMesh(radius[:, np.newaxis] * BALL.vertices, BALL.faces)


def pressed_balls(apart: float) -> TriangleMesh:
    """The union of two balls of radius 1, whose middles are twice so far apart."""
    along = np.abs(BALL.vertices[:, 0])
    return about_origin(apart * along + np.sqrt(1 - apart**2 * (1 - along**2).clip(0, 1)))


@pytest.mark.parametrize("ratio", [1, 0.7])
def test_two_balls_that_touch_are_two_bodies(ratio: float) -> None:
    # An oval of Cassini, whose neck is short beside its halves, one of which is smaller by a factor.
    cosine = BALL.vertices[:, 0] ** 2 - (BALL.vertices[:, 1:] ** 2).sum(axis=1)
    size = np.sqrt(cosine + np.sqrt(cosine**2 + 1.005**4 - 1))
    size = np.where(BALL.vertices[:, 0] < 0, ratio, 1) * size
    assert one_body(about_origin(size)).outcome != "passed"


def test_balls_pressed_together_are_two_bodies_by_their_crease() -> None:
    found = one_body(pressed_balls(0.9))
    assert found.value is not None and found.value > 0.75, "as long as round a person"
    assert found.outcome != "passed"
    assert abs(found.places[0][0]) < 0.05, "the place is between them"


def test_a_crease_that_does_not_run_all_round_parts_no_bodies() -> None:
    # The same balls, but half of their crease is filled.
    pressed = np.linalg.norm(pressed_balls(0.9).vertices, axis=1)
    filled = np.where(BALL.vertices[:, 1] > 0, pressed.clip(min=1), pressed)
    assert one_body(about_origin(filled)).outcome == "passed"


@pytest.mark.parametrize("knobs", [0, 1])
def test_a_rod_is_one_body_and_so_is_one_with_thick_ends(knobs: int) -> None:
    rod = tube(9.0).vertices * [3, 1, 1]
    from_end = np.abs(rod[:, :1]).max() - np.abs(rod[:, :1])
    thick = 1 + knobs * np.exp(-((from_end / 0.4) ** 2)) * [0, 1, 1]
    assert one_body(TriangleMesh(rod * thick, BALL.faces)).outcome == "passed"


@pytest.mark.parametrize("middle", [1.2, 0.85])
def test_a_rod_between_two_balls_is_one_body_though_creases_run_round_its_ends(
    middle: float,
) -> None:
    def field(points: FloatArray) -> FloatArray:
        aside = np.abs(points[..., :1]) - middle
        balls = np.linalg.norm(np.concatenate([aside, points[..., 1:]], axis=-1), axis=-1)
        width = np.linalg.norm(points[..., 1:], axis=-1)
        rod = np.maximum(width - 0.25, aside[..., 0])
        return np.asarray(np.minimum(rod, balls - 0.7))

    places = np.stack(np.meshgrid(*3 * [np.arange(-2, 2, 0.05)], indexing="ij"), axis=-1)
    vertices, faces = level_set(-field(places).astype(np.float32), np.float32(0))
    found = one_body(TriangleMesh(vertices * 0.05, faces))
    assert found.value is not None and found.value < 0.75, "as short as where balls touch"
    assert found.outcome == "passed"


@pytest.mark.parametrize("seed", [1, 101, 108])
def test_a_shaft_of_small_faces_is_one_body(seed: int) -> None:
    # By all faces, lines beside its creases seemed to be long.
    mesh = machine_part(np.random.default_rng(seed), 1)
    assert len(mesh.faces) > 1.5 * N_FACES
    assert one_body(mesh).outcome == "passed"


@pytest.mark.parametrize("is_closed", [True, False])
def test_balls_of_small_faces_that_touch_are_two_bodies(is_closed: bool) -> None:
    pressed = pressed_balls(0.9)
    fine = TriangleMesh(*subdivide(pressed.vertices, pressed.faces))  # type: ignore[no-untyped-call]
    assert len(fine.faces) > 1.5 * N_FACES
    kept = slice(None if is_closed else -1)
    found = one_body(TriangleMesh(fine.vertices, fine.faces[kept]))
    assert found.outcome != "passed"
    assert abs(found.places[0][0]) < 0.05, "the place is between them"


# --- limbs --------------------------------------------------------------------------------------------


def ratio_of(scan: PointCloud | TriangleMesh) -> float | None:
    """How much more the form is like those of people without a limb."""
    judged = judged_signature(process(scan))
    assert judged is not None
    return limbless_ratio(judged.values)


@pytest.mark.parametrize("seed", [1, 3])
def test_the_form_of_a_person_tells_that_a_limb_is_missing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mesh = body(make_subject("person", rng), POSES["person"]["stand"], rng)
    person = Body("somebody", "somebody", mesh)
    points = SENSORS["uniform"](person, rng)
    cut = points[left_by("limb", points, person, rng)]
    for of, outcome in ((points, "passed"), (cut, "failed")):
        ratio = ratio_of(PointCloud(of))
        assert ratio is not None
        assert limbs_check(ratio).outcome == outcome


def test_a_ball_has_no_limbs_that_could_be_missing() -> None:
    assert ratio_of(BALL) is None


def test_ends_that_are_smaller_than_those_of_whole_people_are_none() -> None:
    points, normals = capsule()
    kept = points[:, 0] < 0.5
    fit = fit_of(cloud_of(points[kept], normals[kept]), tube(0.5))
    size = fit.ends[0].size
    assert ends_check(fit, 0.9 * size).outcome == "failed"
    found = ends_check(fit, 1.1 * size)
    assert (found.outcome, found.value, found.places) == ("passed", 0, ())


# --- names of the parts of a person -------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_known_places_of_a_standing_person_are_named(seed: int) -> None:
    mesh = body(
        make_subject("person", np.random.default_rng(seed)), POSES["person"]["stand"]
    )
    person = person_of(mesh.vertices, mesh.faces)
    assert person is not None
    known = standing_places(mesh) | {
        "toes": int(person.feet[0]),
        "fingers": int(person.hands[0]),
    }
    named = {}
    for name, vertex in known.items():
        named[name] = parts_at(mesh.vertices[[vertex]], mesh, person)
    face = named.pop("face")
    assert face in {("the head",), ()}
    assert named == {
        "crown": ("the head",),
        "chest": ("the trunk",),
        "back": ("the trunk",),
        "thigh": ("a leg",),
        "shin": ("a leg",),
        "toes": ("a foot",),
        "fingers": ("a hand",),
    }


def test_a_hole_of_a_body_that_is_no_person_has_no_part() -> None:
    points = on_ball()
    pierced = points[np.linalg.norm(points - [0, 0, 1], axis=1) > 0.2]
    assert checks_of(cloud_of(pierced), BALL)["Largest hole"].parts == ()
