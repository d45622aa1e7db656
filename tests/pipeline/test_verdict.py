"""Scans that look whole and are not: each is refused, or its shape says that it is not sound.

The faults are those that gave wrong neighbours without a word when the pipeline was attacked.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from pcretrieve import PointCloud, TriangleMesh, process
from pcretrieve.checks import Check, fit_checks, verdict_of
from pcretrieve.descriptors import describe
from pcretrieve.errors import ReconstructionError
from pcretrieve.options import SignatureOptions
from pcretrieve.simulation import UniformOptions, scan_uniformly
from pcretrieve.simulation.bodies import POSES, body, make_subject
from pcretrieve.values import FloatArray, Shape, Verdict

Fault = Callable[[TriangleMesh, FloatArray, np.random.Generator], PointCloud | TriangleMesh]


def heights(points: FloatArray) -> FloatArray:
    """Heights of points, 0 at the lowest and 1 at the highest."""
    y = points[:, 1]
    return np.asarray((y - y.min()) / np.ptp(y))


def a_tenth_of_the_points(person: TriangleMesh, points: FloatArray, rng: np.random.Generator) -> PointCloud:
    return PointCloud(points[::10])


def the_upper_half_100_times_thinner(
    person: TriangleMesh, points: FloatArray, rng: np.random.Generator
) -> PointCloud:
    return PointCloud(points[(heights(points) < 0.5) | (rng.random(len(points)) < 0.01)])


def the_left_half_10_times_thinner(
    person: TriangleMesh, points: FloatArray, rng: np.random.Generator
) -> PointCloud:
    return PointCloud(points[(points[:, 0] < np.median(points[:, 0])) | (rng.random(len(points)) < 0.1)])


def a_floor_under_the_feet(person: TriangleMesh, points: FloatArray, rng: np.random.Generator) -> PointCloud:
    radius, turn = 0.1 * person.diagonal * np.sqrt(rng.random(6000)), 2 * np.pi * rng.random(6000)
    x, _, z = points[heights(points) < 0.02].mean(axis=0)
    low = np.full(6000, points[:, 1].min())
    floor = np.column_stack([x + radius * np.cos(turn), low, z + radius * np.sin(turn)])
    return PointCloud(np.concatenate([points, floor]))


def two_bodies_that_touch(person: TriangleMesh, points: FloatArray, rng: np.random.Generator) -> PointCloud:
    beside = np.array([0.985 * np.ptp(points[:, 0]), 0, 0])
    return PointCloud(np.concatenate([points, points + beside]))


def the_upper_half_alone(person: TriangleMesh, points: FloatArray, rng: np.random.Generator) -> PointCloud:
    return PointCloud(points[heights(points) > 0.5])


def no_lower_legs(person: TriangleMesh, points: FloatArray, rng: np.random.Generator) -> PointCloud:
    return PointCloud(points[heights(points) > 0.25])


def one_hole(person: TriangleMesh, points: FloatArray, rng: np.random.Generator) -> PointCloud:
    knee = points[np.abs(heights(points) - 0.28).argmin()]
    return PointCloud(points[np.linalg.norm(points - knee, axis=1) > 0.1 * person.diagonal])


def two_vertices_welded(person: TriangleMesh, points: FloatArray, rng: np.random.Generator) -> TriangleMesh:
    low, high = person.vertices[:, 1].argmin(), person.vertices[:, 1].argmax()
    return TriangleMesh(person.vertices, np.where(person.faces == low, high, person.faces))


def turned(person: TriangleMesh, points: FloatArray, rng: np.random.Generator) -> PointCloud:
    return PointCloud(points @ np.linalg.qr(rng.normal(size=(3, 3)))[0])


def mirrored(person: TriangleMesh, points: FloatArray, rng: np.random.Generator) -> PointCloud:
    return PointCloud(points * [-1, 1, 1])


def every_point_twice(person: TriangleMesh, points: FloatArray, rng: np.random.Generator) -> PointCloud:
    return PointCloud(np.concatenate([points, points]))


def arms_that_cross_the_trunk(
    person: TriangleMesh, points: FloatArray, rng: np.random.Generator
) -> PointCloud:
    side = np.abs(points[:, 0])
    folded = np.where(side > 0.2, np.sign(points[:, 0]) * (0.2 - 0.8 * (side - 0.2)), points[:, 0])
    return PointCloud(np.column_stack([folded, points[:, 1:]]))


FAULTS: tuple[Fault, ...] = (
    a_tenth_of_the_points,
    the_upper_half_100_times_thinner,
    the_left_half_10_times_thinner,
    a_floor_under_the_feet,
    two_bodies_that_touch,
    the_upper_half_alone,
    no_lower_legs,
    one_hole,
    two_vertices_welded,
    arms_that_cross_the_trunk,
    turned,
    mirrored,
    every_point_twice,
)


@pytest.fixture(scope="module")
def person() -> TriangleMesh:
    return body(make_subject("person", np.random.default_rng(1)), POSES["person"]["walk"])


@pytest.fixture(scope="module")
def points(person: TriangleMesh) -> FloatArray:
    whole = UniformOptions(n_points=40_000, noise=0.0005, n_holes=0, outlier_share=0.0)
    return scan_uniformly(person, whole, np.random.default_rng(2)).points


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.__name__)
def test_no_fault_goes_without_a_word(fault: Fault, person: TriangleMesh, points: FloatArray) -> None:
    try:
        shape = process(fault(person, points, np.random.default_rng(3)))
    except ReconstructionError:
        return  # refused, with its reason
    assert shape.verdict is not None
    if shape.verdict.is_sound:
        assert error(shape, person) < 0.15  # the fault was removed
    else:
        assert shape.verdict.reasons


def error(shape: Shape, person: TriangleMesh) -> float:
    """The distance of a log-signature of 23 values, as in docs/decisions.md, from that of the clean mesh."""
    form = SignatureOptions(n_values=23)
    made, true = (np.log(describe(one, form).values) for one in (shape, process(person)))
    return float(np.linalg.norm(made - true))


def test_whole_bodies_are_sound(person: TriangleMesh, points: FloatArray) -> None:
    typical = scan_uniformly(person, UniformOptions(), np.random.default_rng(4))
    for scan in (person, PointCloud(points), typical):
        verdict = process(scan).verdict
        assert verdict is not None and verdict.is_sound, verdict


def test_garbage_is_removed(person: TriangleMesh, points: FloatArray) -> None:
    low, high = points.min(axis=0), points.max(axis=0)
    garbage = np.random.default_rng(5).uniform(low - 0.1, high + 0.1, (2000, 3))
    shape = process(PointCloud(np.concatenate([points, garbage])))
    assert shape.verdict is not None and shape.verdict.is_sound
    assert error(shape, person) < 0.15


# --- the uncertainty ----------------------------------------------------------------------------------


def uncertainty(scan: PointCloud) -> float:
    verdict = process(scan).verdict
    assert verdict is not None
    return verdict.uncertainty


MEASURED = {"filled": 0.0, "ends": 0.0, "gaps": 0.004, "lost": 0.0, "noise": 0.001}


@pytest.mark.parametrize("name", MEASURED)
def test_each_measurement_adds_to_the_uncertainty(name: str) -> None:
    found = [
        verdict_of(fit_checks(**{**MEASURED, name: value})).uncertainty
        for value in np.linspace(MEASURED[name], 0.3, 50)
    ]
    assert (np.diff(found) >= 0).all()
    assert found[-1] > found[0]


# --- the verdict --------------------------------------------------------------------------------------


def check(name: str, error: float, verdict: str = "look") -> Check:
    return Check(name, verdict, None, "much", "Look.", error)  # type: ignore[arg-type]


def test_a_failed_check_makes_a_shape_unusable() -> None:
    verdict = verdict_of([check("Gaps", 0.2), check("Normals", 0.0, "failed")])
    assert verdict.judgement == "unusable"
    assert verdict.reasons == ("normals: much", "gaps: much")
    assert verdict_of([check("Gaps", 0.8)]).judgement == "unusable"
    assert verdict_of([check("Gaps", 0.2)]) == Verdict("sound", 0.2)
