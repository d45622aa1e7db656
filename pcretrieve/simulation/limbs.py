"""Limbs: chains of bones with round bends, and their mirror images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from pcretrieve.simulation.skeleton import COLLINEAR, Bone, RoundCone, Vector, vector

__all__ = ["both", "limb", "mirrored"]

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
        link = Bone(f"{joint}_link", parent, at(ends[k] - before), head, front, (), joint, share=0.5)
        bones += [link, Bone(name, link.name, head, tail, front, (flesh,), joint, share=0.5)]
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
        flesh=tuple(replace(cone, start=across(cone.start), end=across(cone.end)) for cone in bone.flesh),
        joint=_right(bone.joint),
        side=-bone.side,
    )


def both(**angles: Vector) -> dict[str, Vector]:
    """The same angles for the left and the right joint of each name.

    **angles: (bend, spread, twist) by the name of the joint without its side; degrees.
    Returns dict of str to 3 floats: angles by the name of the joint with its side; degrees.
    """
    return {f"{side}_{joint}": turn for joint, turn in angles.items() for side in ("left", "right")}


def _right(name: str) -> str:
    return name.replace("left_", "right_", 1)
