"""Bones, the flesh on them, and the poses that turn them.

Conventions, said once: lengths in metres; at rest x points to the body's left, y up and z to its front.
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
    "bone_distance",
    "cone_distance",
    "vector",
]

Vector = tuple[float, float, float]

# Fillet of a round cone that carries on where another ends.
COLLINEAR = 0.2


@dataclass(frozen=True, slots=True)
class RoundCone:
    """The union of balls whose centre and radius go evenly from one end to the other.

    Attributes
    ----------
    start, end : 3 floats
        Centres of the end balls at rest; m.
    radii : 2 floats
        Of the end balls; m.
    depth : float, default 1
        Thickness along the front of its bone, relative to the radius: balls become lenses below 1.
    fillet : float, default 0.7
        Width of the fillet towards the flesh before it, relative to its smaller radius: wide where a limb
        grows out of a trunk, narrow (`COLLINEAR`) where the next piece goes on and a fillet would be a ring.
    """

    start: Vector
    end: Vector
    radii: tuple[float, float]
    depth: float = 1.0
    fillet: float = 0.7


@dataclass(frozen=True, slots=True)
class Bone:
    """A rigid piece of a skeleton.

    Attributes
    ----------
    name : str
    parent : str or None
        The bone that carries this one; None for the root.
    head, tail : 3 floats
        Where it starts, which is what it turns about, and where it ends, at rest; m.
    front : 3 floats
        Where it bends to, at right angles to the bone as far as need be.
    flesh : tuple of RoundCone
        What is around it; none round a link that only makes the bend of a joint rounder.
    joint : str
        The joint whose angles turn it. Several bones of one joint bend it by degrees, as spines do.
    share : float, default 1
        Part of those angles that this bone takes.
    side : {1, -1}, default 1
        -1 mirrors spread and twist, so that left and right limbs read the same angles.
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
    """One individual: a skeleton with its flesh. Hashable, so that its skin is made only once.

    Attributes
    ----------
    family : str
    bones : tuple of Bone
        Parents before children; the first is the root.
    cell : float
        Edge of the grid cells that the skin is made on, about the length of its edges; m.

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
        """The joints that a pose can turn."""
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
    """Two parts of a body that must touch.

    Attributes
    ----------
    bones, onto : tuple of str
        The bones that come and those that they come to rest on.
    by : tuple of str
        The joints that give way until the gap between them is closed.
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
        towards f × d, which for a hanging left limb is away from the body. Joints not named stay at rest.
    contacts : tuple of Contact
        What must touch, whatever the proportions of the subject.
    """

    angles: Mapping[str, Vector] = field(default_factory=dict)
    contacts: tuple[Contact, ...] = ()

    @property
    def joints(self) -> frozenset[str]:
        """The joints that it turns."""
        return frozenset(self.angles).union(*(contact.by for contact in self.contacts))

    @property
    def touching(self) -> bool:
        """Whether parts of the body rest on each other."""
        return bool(self.contacts)

    def jittered(self, joints: frozenset[str], spread: float, rng: np.random.Generator) -> Pose:
        """The pose with normal deviations of `spread` degrees added to every angle of `joints`."""
        angles = {
            joint: np.add(self.angles.get(joint, (0.0, 0.0, 0.0)), rng.normal(0, spread, 3))
            for joint in sorted(joints)
        }
        return replace(self, angles={joint: tuple(turn.tolist()) for joint, turn in angles.items()})


def vector(array: FloatArray) -> Vector:
    """An array of three as a hashable value."""
    x, y, z = array.tolist()
    return (x, y, z)


def bone_distance(bone: Bone, points: FloatArray) -> FloatArray:
    """(…,) distance of (…, 3) points from the flesh of a bone at rest, negative inside; m.

    Right up to the taper of the cones, and a lower bound where they are flattened. Infinite without flesh.
    """
    if not bone.flesh:
        return np.full(points.shape[:-1], np.inf)
    distances = np.array([cone_distance(cone, bone.front, points) for cone in bone.flesh])  # (c, …)
    nearest: FloatArray = distances.min(axis=0)
    return nearest


def cone_distance(cone: RoundCone, front: Vector, points: FloatArray) -> FloatArray:
    """As `bone_distance`, for one round cone."""
    offset, axis = points - np.array(cone.start), np.subtract(cone.end, cone.start)
    if cone.depth != 1:
        # Stretched along the front by 1/depth, lenses are balls again.
        normal = np.array(front) / np.linalg.norm(front)
        stretch = np.eye(3) + (1 / cone.depth - 1) * np.outer(normal, normal)
        offset, axis = offset @ stretch, axis @ stretch
    length2 = axis @ axis
    along = np.clip(offset @ axis / length2, 0, 1) if length2 > 0 else np.zeros(points.shape[:-1])
    radius = cone.radii[0] + along * (cone.radii[1] - cone.radii[0])
    distance: FloatArray = np.linalg.norm(offset - along[..., None] * axis, axis=-1) - radius
    distance *= min(cone.depth, 1.0)
    return distance
