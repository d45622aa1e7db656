"""Laws of articulated bodies: what a pose may change, and what it must not."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from benchmarks.poses import POSES
from benchmarks.simulation import body, make_subject
from benchmarks.simulation.bodies import close_contacts, skin
from benchmarks.simulation.skeleton import (
    Bone,
    Pose,
    RoundCone,
    Subject,
    bone_distance,
    motions,
)

from pcretrieve.values import FloatArray
from pcretrieve.values.topology import defects

FAMILIES = sorted(POSES)


@cache
def someone(family: str) -> Subject:
    return make_subject(family, np.random.default_rng(3))


def tip(subject: Subject, pose: Pose, bone: str) -> FloatArray:
    k = subject.number(bone)
    end: FloatArray = (motions(subject, pose)[k] @ [*subject.bones[k].tail, 1])[:3]
    return end


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_a_body_is_a_closed_oriented_sphere_of_nearly_one_area_in_all_poses(
    family: str,
) -> None:
    subject = someone(family)
    rest = skin(subject).rest
    assert 5_000 < len(rest.vertices) < 10_000
    assert rest.euler_characteristic == 2
    assert rest.volume > 0
    assert not defects(rest)
    for name, pose in POSES[family].items():
        mesh = body(subject, pose)
        assert np.array_equal(mesh.faces, rest.faces), name
        assert mesh.area == pytest.approx(rest.area, rel=0.05), name
        assert mesh.volume == pytest.approx(rest.volume, rel=0.15), name


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_contacts_are_closed_whatever_the_jitter(family: str) -> None:
    """By the distance from the skin of the moving part to the flesh of the other, negative inside."""
    subject, rng = someone(family), np.random.default_rng(0)
    own = skin(subject)
    for name, pose in POSES[family].items():
        jittered = pose.jittered(subject.joints, 2.0, rng)
        moved, mesh = (
            motions(subject, close_contacts(own, jittered)),
            body(subject, jittered),
        )
        for contact in pose.contacts:
            coming = mesh.vertices[
                np.isin(own.owner, [subject.number(bone) for bone in contact.bones])
            ]
            flesh = []
            for number in map(subject.number, contact.onto):
                back = np.linalg.inv(moved[number])
                at_rest = coming @ back[:3, :3].T + back[:3, 3]
                flesh.append(bone_distance(subject.bones[number], at_rest).min())
            assert abs(min(flesh)) / subject.size < 0.01, name


def test_bend_goes_to_the_front_and_spread_away_from_the_body() -> None:
    subject, still = someone("person"), Pose()
    hand = tip(subject, still, "left_hand")
    assert tip(subject, Pose({"left_elbow": (60, 0, 0)}), "left_hand")[2] > hand[2] + 0.1
    assert (
        tip(subject, Pose({"left_shoulder": (0, 30, 0)}), "left_hand")[1] > hand[1] + 0.1
    )
    foot = tip(subject, still, "left_calf")
    assert tip(subject, Pose({"left_hip": (0, 30, 0)}), "left_calf")[0] > foot[0] + 0.1


def test_the_skin_of_a_rod_is_a_capsule_and_converges() -> None:
    radius, length = 0.3, 1.0
    area, volume = (
        2 * np.pi * radius * (length + 2 * radius),
        np.pi * radius**2 * (length + 4 / 3 * radius),
    )
    start, end = (0.0, 0.0, 0.0), (0.0, length, 0.0)
    rod = Bone(
        "rod",
        None,
        start,
        end,
        (0, 0, 1),
        (RoundCone(start, end, (radius, radius)),),
        "rod",
    )
    errors = []
    for cell in (0.12, 0.06, 0.03):
        mesh = skin(Subject("rod", (rod,), cell)).rest
        errors.append((1 - mesh.area / area, 1 - mesh.volume / volume))
    assert errors[-1] == pytest.approx((0, 0), abs=0.005)
    # Vertices lie on the surface, so that halving the cells quarters the error.
    assert all(coarse[1] / fine[1] > 3 for coarse, fine in pairwise(errors))
