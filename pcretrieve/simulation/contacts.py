"""Contacts between parts of a body, such as hands on hips or a closed fist."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from pcretrieve.simulation.flesh import bone_distance
from pcretrieve.simulation.kinematics import motions
from pcretrieve.simulation.skeleton import Contact, Pose
from pcretrieve.simulation.skin import Skin, blend
from pcretrieve.values import FloatArray

__all__ = ["close_contacts"]

# Weight of the change of an angle (radians) against a gap (body sizes) in the least-squares problem: large
# enough to keep the joints near the given pose, small enough to close every gap to less than a thousandth of
# the body size.
STIFFNESS = 0.02

# Step of the finite differences, relative to each angle. The gap is not smooth in the angles, because the
# nearest vertex of the skin changes; the step is wide enough to average over these changes.
DIFFERENCE = 0.01


def close_contacts(skin: Skin, pose: Pose) -> Pose:
    """Change the angles of a pose until its contacts touch.

    The sum of squares of the gaps, in body sizes, and of `STIFFNESS` times the changes of the angles of the
    joints of the contacts, in radians, is minimised.
    """
    joints = sorted({joint for contact in pose.contacts for joint in contact.by})
    if not joints:
        return pose
    size = skin.subject.size
    given = np.radians([pose.angles.get(joint, (0, 0, 0)) for joint in joints]).ravel()  # (3j,)

    def turned(angles: FloatArray) -> Pose:
        triples = np.degrees(angles).reshape(-1, 3).tolist()
        changed = {joint: tuple(triple) for joint, triple in zip(joints, triples, strict=True)}
        return replace(pose, angles={**pose.angles, **changed})

    def residuals(angles: FloatArray) -> FloatArray:
        moved = motions(skin.subject, turned(angles))
        gaps = [_gap(skin, moved, contact) / size for contact in pose.contacts]
        return np.concatenate([gaps, STIFFNESS * (angles - given)])

    return turned(least_squares(residuals, given, diff_step=np.full(len(given), DIFFERENCE)).x)


def _gap(skin: Skin, moved: FloatArray, contact: Contact) -> float:
    """Signed distance from the skin of the moving part to the flesh of the other, negative inside; m."""
    bones = skin.subject.bones
    coming = np.isin(skin.owner, [skin.subject.number(name) for name in contact.bones])
    points = blend(skin.weights[coming], moved, skin.rest.vertices[coming])
    gaps = []
    for number in map(skin.subject.number, contact.onto):
        to_rest = np.linalg.inv(moved[number])
        gaps.append(bone_distance(bones[number], points @ to_rest[:3, :3].T + to_rest[:3, 3]).min())
    return float(min(gaps))
