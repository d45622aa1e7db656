"""Articulated bodies: people, four-legged animals and hands in many poses."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from pcretrieve.errors import InputError, OptionError
from pcretrieve.simulation import animals, hands, people, people_poses
from pcretrieve.simulation.contacts import close_contacts
from pcretrieve.simulation.kinematics import motions
from pcretrieve.simulation.skeleton import Bone, Pose, Subject
from pcretrieve.simulation.skin import follow, skin
from pcretrieve.values import TriangleMesh

__all__ = ["POSES", "body", "make_subject"]

# Measures are clipped to this many standard deviations about the mean.
LARGEST_DEVIATION = 2.0


@dataclass(frozen=True, slots=True)
class _Family:
    """A family of bodies: the distributions of their measures, the function that builds them, and poses."""

    measures: Mapping[str, tuple[float, float]]
    skeleton: Callable[[Mapping[str, float]], tuple[Bone, ...]]
    cell: float
    poses: Mapping[str, Pose]


FAMILIES = {
    "person": _Family(people.MEASURES, people.skeleton, people.CELL, people_poses.POSES),
    "animal": _Family(animals.MEASURES, animals.skeleton, animals.CELL, animals.POSES),
    "hand": _Family(hands.MEASURES, hands.skeleton, hands.CELL, hands.POSES),
}

POSES: Mapping[str, Mapping[str, Pose]] = {name: family.poses for name, family in FAMILIES.items()}
"""Poses by family and name. In poses with contacts (`Pose.touching`) parts of the body touch each other."""


def make_subject(family: str, rng: np.random.Generator) -> Subject:
    """An individual of a family, with lengths and girths drawn from normal distributions."""
    if family not in FAMILIES:
        raise OptionError(f"family must be one of {', '.join(FAMILIES)}, got {family!r}")
    kind = FAMILIES[family]
    deviations = np.clip(rng.standard_normal(len(kind.measures)), -LARGEST_DEVIATION, LARGEST_DEVIATION)
    measures = {
        name: mean * (1 + spread * deviation)
        for (name, (mean, spread)), deviation in zip(kind.measures.items(), deviations.tolist(), strict=True)
    }
    return Subject(family, kind.skeleton(measures), kind.cell)


def body(
    subject: Subject, pose: Pose, rng: np.random.Generator | None = None, *, jitter: float = 2.0
) -> TriangleMesh:
    """The surface of a subject in a pose.

    All poses of one subject have the same faces, so that each surface is a closed manifold of Euler
    characteristic 2, even where parts touch; there the surface may intersect itself slightly.

    jitter: standard deviation of these numbers; degrees.
    Returns TriangleMesh: a surface of about 7000 vertices; m. The first call for a subject computes the skin,
        which takes some seconds; further calls only deform it.
    """
    strange = sorted(pose.joints - subject.joints)
    if strange:
        raise InputError(
            f"a pose must turn joints of the {subject.family}, got {', '.join(strange)}: "
            f"take one of POSES[{subject.family!r}]"
        )
    if rng is not None:
        pose = pose.jittered(subject.joints, jitter, rng)
    own = skin(subject)
    return follow(own, motions(subject, close_contacts(own, pose)))
