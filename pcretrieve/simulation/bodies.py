"""Articulated bodies: people, four-legged animals and hands in many poses."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pcretrieve.errors import InputError, OptionError
from pcretrieve.simulation import animals, hands, people
from pcretrieve.simulation.skeleton import Bone, Pose, Subject, motions
from pcretrieve.simulation.skin import close_contacts, follow, skin
from pcretrieve.values import FloatArray, TriangleMesh

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
    "person": _Family(people.MEASURES, people.skeleton, people.CELL, people.POSES),
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


#: Poses of people who sit on a seat.
SEATED = ("sit", "legs_crossed")

# Largest height above a support at which soft parts touch it, and extent of the hips about the origin, to the
# sides and to the front; diagonals.
TOUCHING = 0.015
HIPS = (0.12, 0.05)

# Largest vertical part of the unit normal of a surface that faces down.
DOWN = -0.5


def on_support(mesh: TriangleMesh, points: FloatArray, *, seated: bool) -> NDArray[np.bool_]:
    """The points of a person at which the body touches the ground or a seat.

    points: (n, 3) float64, points on the surface, with noise; unit of the mesh.
    Returns (n,) bool: points of faces that face down, near the lowest point of the body or of the hips.
    """
    x, y, z = mesh.vertices.T
    supports = [y.min()]
    if seated:
        supports.append(y[(abs(x) < HIPS[0] * mesh.diagonal) & (abs(z) < HIPS[1] * mesh.diagonal)].min())
    _, nearest = cKDTree(mesh.vertices[mesh.faces].mean(axis=1)).query(points)
    faces_down = mesh.area_vectors[nearest, 1] < DOWN * mesh.face_areas[nearest]
    heights = abs(points[:, 1, None] - np.array(supports)).min(axis=1)
    return np.asarray(faces_down & (heights < TOUCHING * mesh.diagonal))
