"""Forward kinematics: how a pose moves the bones.

A rigid motion is a (4, 4) matrix that maps a point of the rest pose to the same point in another pose.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from pcretrieve.simulation.skeleton import Pose, Subject
from pcretrieve.values import FloatArray

__all__ = ["motions"]


def motions(subject: Subject, pose: Pose) -> FloatArray:
    """The rigid motion of each bone, from the rest pose to another pose.

    Returns (b, 4, 4) float64: a bone rotates about its own head at rest, and then moves with its parent. The
        root rotates about its head.
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
    angles = np.array([np.multiply(bone.share, pose.angles.get(bone.joint, (0, 0, 0))) for bone in bones])
    along = np.array([np.subtract(bone.tail, bone.head) for bone in bones])  # (b, 3)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    front = np.array([bone.front for bone in bones], dtype=np.float64)
    front -= np.einsum("bi,bi->b", front, along)[:, None] * along
    front /= np.linalg.norm(front, axis=1, keepdims=True)
    side = np.array([bone.side for bone in bones])[:, None]
    bend, spread, twist = (np.radians(angles[:, k, None]) for k in range(3))  # (b, 1) each
    turn = (
        Rotation.from_rotvec(spread * side * front)
        * Rotation.from_rotvec(bend * np.cross(along, front))
        * Rotation.from_rotvec(twist * side * along)
    )
    matrices: FloatArray = turn.as_matrix()
    return matrices
