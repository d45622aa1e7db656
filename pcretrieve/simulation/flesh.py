"""Distances from the flesh of bones."""

from __future__ import annotations

import numpy as np

from pcretrieve.simulation.skeleton import Bone, RoundCone, Vector
from pcretrieve.values import FloatArray

__all__ = ["bone_distance", "cone_distance"]


def bone_distance(bone: Bone, points: FloatArray) -> FloatArray:
    """Signed distance of points from the flesh of a bone at rest.

    Approximate for cones whose radii differ; a lower bound for flattened cones.

    points: (…, 3) float64, in metres.
    Returns (…,) float64: negative inside, infinite without flesh; m.
    """
    if not bone.flesh:
        return np.full(points.shape[:-1], np.inf)
    distances = np.array([cone_distance(cone, bone.front, points) for cone in bone.flesh])  # (c, …)
    nearest: FloatArray = distances.min(axis=0)
    return nearest


def cone_distance(cone: RoundCone, front: Vector, points: FloatArray) -> FloatArray:
    """Signed distance of points from one round cone at rest, as `bone_distance`.

    points: (…, 3) float64, in metres.
    Returns (…,) float64: negative inside; m.
    """
    offset, axis = points - np.array(cone.start), np.subtract(cone.end, cone.start)
    if cone.depth != 1:
        # A stretch along the front by 1/depth turns the ellipsoids into balls.
        normal = np.array(front) / np.linalg.norm(front)
        stretch = np.eye(3) + (1 / cone.depth - 1) * np.outer(normal, normal)
        offset, axis = offset @ stretch, axis @ stretch
    length2 = axis @ axis
    along = np.clip(offset @ axis / length2, 0, 1) if length2 > 0 else np.zeros(points.shape[:-1])
    radius = cone.radii[0] + along * (cone.radii[1] - cone.radii[0])
    distance: FloatArray = np.linalg.norm(offset - along[..., None] * axis, axis=-1) - radius
    distance *= min(cone.depth, 1.0)
    return distance
