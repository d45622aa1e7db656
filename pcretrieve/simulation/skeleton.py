"""Skeletons: bones with the flesh round them, contacts and poses.

Lengths are in metres. In the rest pose the x axis points to the left of the body, y up and z to its front.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from pcretrieve.errors import InputError
from pcretrieve.types import FloatArray

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
    """The union of balls whose centre and radius are linear functions of one parameter.

    Attributes
    ----------
    start, end : 3 floats
        Centres of the first and the last ball at rest; m.
    radii : 2 floats
        Radii of the first and the last ball; m.
    depth : float, default 1
        Thickness along the front of the bone, relative to the radius: below 1, the balls are ellipsoids.
    fillet : float, default 0.7
        Width of the fillet towards the flesh of the bones before, relative to the smaller radius: wide where
        a limb begins at a trunk, narrow (`COLLINEAR`) between pieces of one limb, round which a wide fillet
        would be a visible ring.
    """

    start: Vector
    end: Vector
    radii: tuple[float, float]
    depth: float = 1.0
    fillet: float = 0.7


@dataclass(frozen=True, slots=True)
class Bone:
    """A rigid part of a skeleton.

    Attributes
    ----------
    name : str
        Unique in the skeleton.
    parent : str or None
        Name of the bone that carries this bone; None for the root.
    head, tail : 3 floats
        Start of the bone, which is its centre of rotation, and end of the bone, at rest; m.
    front : 3 floats
        Direction to which the bone bends; its component perpendicular to the bone is used.
    flesh : tuple of RoundCone
        The flesh round the bone. Empty for a link, a bone that only makes a bent joint rounder.
    joint : str
        Name of the joint that rotates the bone. Several bones may share the angles of one joint, as in a
        spine.
    share : float, default 1
        Fraction of the angles of the joint that this bone takes.
    side : {1, -1}, default 1
        -1 mirrors spread and twist, so that the same angles describe left and right limbs.
    """

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
    """One individual: a skeleton with its flesh. Hashable, so that the skin of a subject is made only once.

    Attributes
    ----------
    family : str
        ``person``, ``animal`` or ``hand``.
    bones : tuple of Bone
        Parents before children; the first is the root.
    cell : float
        Edge of the grid cells on which the skin is computed, about the length of the edges of the skin; m.

    Raises
    ------
    InputError
        If names repeat, a parent does not come first, a bone has no length, or a radius is not positive.
    """

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
        """Position of a bone in `bones`.

        Parameters
        ----------
        name : str
            Name of the bone.

        Returns
        -------
        int
            The position.

        Raises
        ------
        ValueError
            If there is no such bone.
        """
        return [bone.name for bone in self.bones].index(name)


@dataclass(frozen=True, slots=True)
class Contact:
    """Two parts of a body that must touch.

    Attributes
    ----------
    bones, onto : tuple of str
        Names of the bones of one part, which moves, and of the other part, which it touches.
    by : tuple of str
        Names of the joints that are adjusted until the gap between the parts is closed.
    """

    bones: tuple[str, ...]
    onto: tuple[str, ...]
    by: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Pose:
    """Joint angles.

    Attributes
    ----------
    angles : mapping of joint to (bend, spread, twist)
        Degrees. A bone along d with front f first twists about d, then bends towards f, then spreads
        towards f × d, which for a hanging left limb is away from the body. Other joints stay at rest.
    contacts : tuple of Contact
        Parts that must touch, for any proportions of the subject.
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

        Parameters
        ----------
        joints : frozenset of str
            Names of the joints whose angles are changed.
        spread : float
            Standard deviation of the normal distribution of each angle; degrees.
        rng : numpy.random.Generator
            Source of the random numbers.

        Returns
        -------
        Pose
            The pose with changed angles.
        """
        angles = {
            joint: np.add(self.angles.get(joint, (0.0, 0.0, 0.0)), rng.normal(0, spread, 3))
            for joint in sorted(joints)
        }
        return replace(self, angles={joint: tuple(turn.tolist()) for joint, turn in angles.items()})


def vector(array: FloatArray) -> Vector:
    """An array of three numbers as a hashable value.

    Parameters
    ----------
    array : (3,) float64
        The numbers.

    Returns
    -------
    tuple of 3 floats
        The numbers.
    """
    x, y, z = array.tolist()
    return (x, y, z)
