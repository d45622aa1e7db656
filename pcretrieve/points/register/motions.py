"""Rigid motions of points and directions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeAlias

import numpy as np

from pcretrieve.values import FloatArray

__all__ = ["Poses", "moved", "turned"]

#: Rigid motions, (4, 4) float64, of views into a common frame, by the number of the view.
Poses: TypeAlias = Mapping[int, FloatArray]


def moved(motion: FloatArray, points: FloatArray) -> FloatArray:
    """Apply rigid motions to points.

    motion: (4, 4) or (m, 4, 4) float64, one motion, or m motions.
    points: (n, 3) float64, coordinates.
    Returns (n, 3) or (m, n, 3) float64: coordinates after the motion, or after each motion.
    """
    return np.asarray(turned(motion, points) + motion[..., None, :3, 3])


def turned(motion: FloatArray, directions: FloatArray) -> FloatArray:
    """Apply the rotations of rigid motions to directions.

    motion: (4, 4) or (m, 4, 4) float64, one motion, or m motions.
    directions: (n, 3) float64, vectors.
    Returns (n, 3) or (m, n, 3) float64: vectors after the rotation, or after each rotation.
    """
    return np.asarray(directions @ np.swapaxes(motion[..., :3, :3], -1, -2))
