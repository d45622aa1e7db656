"""Skeletons: bones with the flesh round them, contacts and poses.

Lengths are in metres. In the rest pose the x axis points to the left of the body, y up and z to its front.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from pcretrieve.values import FloatArray

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

    angles: (bend, spread, twist) by joint; degrees. A bone along d with front f first twists about d, then
        bends towards f, then spreads towards f × d, which for a hanging left limb is away from the body.
        Other joints stay at rest.
    """

    angles: Mapping[str, Vector] = field(default_factory=dict)
    contacts: tuple[Contact, ...] = ()

    @property
    def joints(self) -> frozenset[str]:
        """Names of the joints that the pose rotates."""
        return frozenset(self.angles).union(*(contact.by for contact in self.contacts))

    def jittered(
        self, joints: frozenset[str], spread: float, rng: np.random.Generator
    ) -> Pose:
        """The pose with normal random changes of its angles, of the standard deviation `spread`; degrees."""
        angles = {
            joint: np.add(
                self.angles.get(joint, (0.0, 0.0, 0.0)), rng.normal(0, spread, 3)
            )
            for joint in sorted(joints)
        }
        return replace(
            self, angles={joint: tuple(turn.tolist()) for joint, turn in angles.items()}
        )


def vector(array: FloatArray) -> Vector:
    """An array of three numbers as a hashable value."""
    x, y, z = array.tolist()
    return (x, y, z)


def motions(subject: Subject, pose: Pose) -> FloatArray:
    """(b, 4, 4) rigid motion of each bone, from the rest pose to another pose.

    A bone rotates about its own head at rest, and then moves with its parent.
    """
    turns = _turns(subject, pose)  # (b, 3, 3)
    heads = np.array([bone.head for bone in subject.bones])  # (b, 3)
    local = np.tile(np.eye(4), (len(subject.bones), 1, 1))
    local[:, :3, :3] = turns
    local[:, :3, 3] = heads - np.einsum("bij,bj->bi", turns, heads)
    number = {bone.name: k for k, bone in enumerate(subject.bones)}
    result: FloatArray = local.copy()
    for k, bone in enumerate(subject.bones):
        if bone.parent is not None:
            result[k] = result[number[bone.parent]] @ local[k]
    return result


def _turns(subject: Subject, pose: Pose) -> FloatArray:
    """(b, 3, 3) rotation of each bone relative to its parent, in the axes of the rest pose."""
    bones = subject.bones
    angles = np.array(
        [
            np.multiply(bone.share, pose.angles.get(bone.joint, (0, 0, 0)))
            for bone in bones
        ]
    )
    along = np.array([np.subtract(bone.tail, bone.head) for bone in bones])  # (b, 3)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    front = np.array([bone.front for bone in bones], dtype=np.float64)
    front -= np.einsum("bi,bi->b", front, along)[:, None] * along
    front /= np.linalg.norm(front, axis=1, keepdims=True)
    side = np.array([bone.side for bone in bones])[:, None]
    # (b, 1) each.
    bend, spread, twist = (np.radians(angles[:, k, None]) for k in range(3))
    turn = (
        Rotation.from_rotvec(spread * side * front)
        * Rotation.from_rotvec(bend * np.cross(along, front))
        * Rotation.from_rotvec(twist * side * along)
    )
    return np.asarray(turn.as_matrix())


def bone_distance(bone: Bone, points: FloatArray) -> FloatArray:
    """(…,) signed distance of points (…, 3) from the flesh of a bone at rest; m.

    Negative inside, infinite without flesh. Approximate for cones whose radii differ; a lower bound for
    flattened cones.
    """
    if not bone.flesh:
        return np.full(points.shape[:-1], np.inf)
    return np.asarray(
        np.min([cone_distance(cone, bone.front, points) for cone in bone.flesh], axis=0)
    )


def cone_distance(cone: RoundCone, front: Vector, points: FloatArray) -> FloatArray:
    """(…,) signed distance of points (…, 3) from one round cone at rest, as by `bone_distance`."""
    offset, axis = points - np.array(cone.start), np.subtract(cone.end, cone.start)
    if cone.depth != 1:
        # A stretch along the front by 1/depth turns the ellipsoids into balls.
        normal = np.array(front) / np.linalg.norm(front)
        stretch = np.eye(3) + (1 / cone.depth - 1) * np.outer(normal, normal)
        offset, axis = offset @ stretch, axis @ stretch
    length2 = axis @ axis
    along = (
        np.clip(offset @ axis / length2, 0, 1)
        if length2 > 0
        else np.zeros(points.shape[:-1])
    )
    radius = cone.radii[0] + along * (cone.radii[1] - cone.radii[0])
    distance: FloatArray = (
        np.linalg.norm(offset - along[..., None] * axis, axis=-1) - radius
    )
    distance *= min(cone.depth, 1.0)
    return distance


# Length of a link, relative to the radius of the limb. Linear blend skinning folds the skin on the inside of
# a joint that bends at one point; with half of the bend at either end of a link the joint stays round.
LINK = 1.2


def limb(
    parent: str,
    start: ArrayLike,
    along: ArrayLike,
    front: Vector,
    pieces: Sequence[tuple[str, str, float, tuple[float, float]]],
) -> tuple[Bone, ...]:
    """A straight chain of bones, with a link before each bone that takes half of the angles of its joint.

    pieces: sequence of (joint, bone, length, radii), from the trunk outwards; m.
    """
    direction = np.asarray(along, dtype=np.float64) / np.linalg.norm(along)
    ends = np.cumsum([0.0, *(length for _, _, length, _ in pieces)])
    half = [LINK / 2 * radii[0] for _, _, _, radii in pieces]

    def at(distance: float) -> Vector:
        return vector(np.asarray(start) + distance * direction)

    bones: list[Bone] = []
    for k, (joint, name, _, radii) in enumerate(pieces):
        # The first link begins at the joint: there is no bone of this limb before it to shorten.
        before = half[k] if k else 0.0
        after = half[k + 1] if k + 1 < len(pieces) else 0.0
        head, tail = at(ends[k] + half[k]), at(ends[k + 1] - after)
        flesh = RoundCone(at(ends[k]), at(ends[k + 1]), radii)
        if k:
            flesh = replace(flesh, fillet=COLLINEAR)
        link = Bone(
            f"{joint}_link",
            parent,
            at(ends[k] - before),
            head,
            front,
            (),
            joint,
            share=0.5,
        )
        bones += [
            link,
            Bone(name, link.name, head, tail, front, (flesh,), joint, share=0.5),
        ]
        parent = name
    return tuple(bones)


def mirrored(bone: Bone) -> Bone:
    """The right bone that is the mirror image of a left bone."""

    def across(point: Vector) -> Vector:
        return (-point[0], point[1], point[2])

    return replace(
        bone,
        name=_right(bone.name),
        parent=_right(bone.parent or ""),
        head=across(bone.head),
        tail=across(bone.tail),
        front=across(bone.front),
        flesh=tuple(
            replace(cone, start=across(cone.start), end=across(cone.end))
            for cone in bone.flesh
        ),
        joint=_right(bone.joint),
        side=-bone.side,
    )


Angle = float | Vector


def turn(**angles: Angle) -> dict[str, Vector]:
    """(bend, spread, twist) by joint; degrees. A number is a bend alone."""
    return {
        joint: angle if isinstance(angle, tuple) else (angle, 0, 0)
        for joint, angle in angles.items()
    }


def left(**angles: Angle) -> dict[str, Vector]:
    """The angles of left joints, by their names without the side."""
    return {f"left_{joint}": angle for joint, angle in turn(**angles).items()}


def right(**angles: Angle) -> dict[str, Vector]:
    """The angles of right joints, by their names without the side."""
    return {f"right_{joint}": angle for joint, angle in turn(**angles).items()}


def both(**angles: Angle) -> dict[str, Vector]:
    """The same angles for the left and the right joint of each name."""
    return left(**angles) | right(**angles)


def _right(name: str) -> str:
    return name.replace("left_", "right_", 1)
