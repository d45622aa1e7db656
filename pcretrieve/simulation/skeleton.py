"""Skeletons: bones with the flesh round them, contacts and poses.

Lengths are in metres. In the rest pose the x axis points to the left of the body, y up and z to its front.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from pcretrieve.errors import InputError
from pcretrieve.values import FloatArray

__all__ = [
    "COLLINEAR",
    "Bone",
    "Contact",
    "Pose",
    "RoundCone",
    "Subject",
    "Vector",
    "vector",
]

Vector = tuple[float, float, float]

# Fillet of a round cone that continues another one in the same direction.
COLLINEAR = 0.2


@dataclass(frozen=True, slots=True)
class RoundCone:
    """The union of balls whose centre and radius are linear functions of one parameter."""

    start: Vector
    end: Vector
    radii: tuple[float, float]
    depth: float = 1.0
    fillet: float = 0.7


@dataclass(frozen=True, slots=True)
class Bone:
    """A rigid part of a skeleton."""

    name: str
    parent: str | None
    head: Vector
    tail: Vector
    front: Vector
    flesh: tuple[RoundCone, ...]
    joint: str
    share: float = 1.0
    side: int = 1


@dataclass(frozen=True, slots=True)
class Subject:
    """One individual: a skeleton with its flesh. Hashable, so that the skin of a subject is made once."""

    family: str
    bones: tuple[Bone, ...]
    cell: float

    def __post_init__(self) -> None:
        seen: set[str] = set()
        for bone in self.bones:
            if bone.name in seen:
                raise InputError(f"bones must have distinct names, got {bone.name!r} twice")
            if (bone.parent is None) != (not seen) or not (bone.parent is None or bone.parent in seen):
                raise InputError(
                    f"the first bone must be the only one without a parent and every parent must come before "
                    f"its children, got {bone.name!r} on {bone.parent!r}"
                )
            if bone.head == bone.tail:
                raise InputError(f"bones must have a length, got {bone.name!r} with both ends at {bone.head}")
            if any(radius <= 0 for cone in bone.flesh for radius in cone.radii):
                raise InputError(f"radii must be positive, got {bone.flesh} on {bone.name!r}")
            seen.add(bone.name)

    @property
    def joints(self) -> frozenset[str]:
        """Names of the joints that a pose can rotate."""
        return frozenset(bone.joint for bone in self.bones)

    @property
    def size(self) -> float:
        """Diagonal of the bounding box of the bones at rest; m."""
        ends = np.array([end for bone in self.bones for end in (bone.head, bone.tail)])
        return float(np.linalg.norm(np.ptp(ends, axis=0)))

    def number(self, name: str) -> int:
        """Position of a bone in `bones`."""
        return [bone.name for bone in self.bones].index(name)


@dataclass(frozen=True, slots=True)
class Contact:
    """Two parts of a body that must touch."""

    bones: tuple[str, ...]
    onto: tuple[str, ...]
    by: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Pose:
    """Joint angles.

    angles: mapping of joint to (bend, spread, twist), degrees. A bone along d with front f first twists about
        d, then bends towards f, then spreads towards f × d, which for a hanging left limb is away from the
        body. Other joints stay at rest.
    """

    angles: Mapping[str, Vector] = field(default_factory=dict)
    contacts: tuple[Contact, ...] = ()

    @property
    def joints(self) -> frozenset[str]:
        """Names of the joints that the pose rotates."""
        return frozenset(self.angles).union(*(contact.by for contact in self.contacts))

    @property
    def touching(self) -> bool:
        """Whether parts of the body touch each other."""
        return bool(self.contacts)

    def jittered(self, joints: frozenset[str], spread: float, rng: np.random.Generator) -> Pose:
        """The pose with random changes of its angles.

        spread: standard deviation of the normal distribution of each angle; degrees.
        """
        angles = {
            joint: np.add(self.angles.get(joint, (0.0, 0.0, 0.0)), rng.normal(0, spread, 3))
            for joint in sorted(joints)
        }
        return replace(self, angles={joint: tuple(turn.tolist()) for joint, turn in angles.items()})


def vector(array: FloatArray) -> Vector:
    """An array of three numbers as a hashable value.

    array: (3,) float64, the numbers.
    """
    x, y, z = array.tolist()
    return (x, y, z)
