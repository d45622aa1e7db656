"""Hands and their gestures.

The numbers in the functions that build the skeleton are positions in metres and fractions of the measures.
They were chosen by eye.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from benchmarks.simulation.skeleton import (
    Bone,
    Pose,
    RoundCone,
    Vector,
    limb,
    turn,
    vector,
)
from pcretrieve.values import FloatArray

# Mean in metres, and standard deviation relative to the mean: rounded figures of adults.
MEASURES: dict[str, tuple[float, float]] = {
    "palm_length": (0.095, 0.07),
    "palm_width": (0.080, 0.08),
    "palm_girth": (0.015, 0.12),  # half thickness
    "thumb": (0.105, 0.09),  # with its metacarpal
    "index": (0.072, 0.08),
    "middle": (0.080, 0.08),
    "ring": (0.074, 0.08),
    "little": (0.058, 0.10),
    "finger_girth": (0.0090, 0.10),  # radius
    "thumb_girth": (0.0125, 0.10),  # radius
    "wrist_girth": (0.027, 0.10),  # half width
}

# Edge of the grid cells of the skin: less than half of the thickness of the little finger; m.
CELL = 0.003

FRONT: Vector = (0.0, 0.0, 1.0)
FINGERS = ("index", "middle", "ring", "little")

# Length of the palm, relative to the length of palm and knuckles.
PALM = 0.72

# Lengths of the phalanges relative to the finger, and of the thumb's metacarpal and phalanges to the thumb.
PHALANGES = (0.46, 0.30, 0.24)
THUMB_BONES = (0.42, 0.32, 0.26)


def skeleton(measures: Mapping[str, float]) -> tuple[Bone, ...]:
    """Bones and flesh of a hand: fingers up, palm to the front, thumb to the left."""
    m = measures
    length, width, girth = m["palm_length"], m["palm_width"], m["palm_girth"]
    stump = RoundCone(
        (0, -0.06, 0), (0, 0.005, 0), (1.08 * m["wrist_girth"], m["wrist_girth"]), 0.72
    )
    # The knuckles lie on an arc; the fingers fan out from the wrist, far enough apart for no fillet to join
    # them.
    x = width * np.array([0.36, 0.12, -0.12, -0.35])
    y = length * np.array([0.95, 1.0, 0.95, 0.86])
    fan = np.radians([11.0, 3.0, -5.0, -14.0])
    # Closed fingers touch the palm, not the knuckles, whose skin is deformed by the bent fingers: palm and
    # knuckles are two bones.
    ends = np.stack([x, y, np.zeros(4)], axis=1)
    roots = ends * [0.45, 0, 1] + [0, 0.012, 0]
    middles = roots + PALM * (ends - roots)
    tip = 0.95 * m["finger_girth"] + 0.002
    radius = girth + PALM * (tip - girth)
    heel = [
        RoundCone(vector(a), vector(b), (girth, radius))
        for a, b in zip(roots, middles, strict=True)
    ]
    knuckles = [
        RoundCone(vector(a), vector(b), (radius, tip))
        for a, b in zip(middles, ends, strict=True)
    ]
    ball = RoundCone(
        (0.30 * width, 0.25 * length, 0.004),
        (0.36 * width, 0.55 * length, 0.004),
        (girth, 0.8 * girth),
    )
    break_line: Vector = (0, PALM * length, 0)
    bones = [
        Bone("stump", None, (0, -0.06, 0), (0, 0, 0), FRONT, (stump,), "stump"),
        Bone("palm", "stump", (0, 0, 0), break_line, FRONT, (*heel, ball), "wrist"),
        Bone(
            "knuckles",
            "palm",
            break_line,
            (0, length, 0),
            FRONT,
            tuple(knuckles),
            "wrist",
            share=0,
        ),
    ]
    for finger, a, b, angle in zip(FINGERS, x, y, fan, strict=True):
        thickness = m["finger_girth"] * (0.86 if finger == "little" else 1.0)
        radii = thickness * np.array([1.0, 0.94, 0.88, 0.78])
        lengths = [m[finger] * share for share in PHALANGES]
        bones += _digit(
            finger, (a, b, 0), (np.sin(angle), np.cos(angle), 0), FRONT, lengths, radii
        )
    radii = m["thumb_girth"] * np.array([1.15, 1.0, 0.92, 0.78])
    root: Vector = (0.26 * width, 0.16 * length, 0.006)
    lengths = [m["thumb"] * share for share in THUMB_BONES]
    bones += _digit(
        "thumb", root, (0.74, 0.64, 0.20), (-0.62, 0.25, 0.74), lengths, radii
    )
    return tuple(bones)


def _digit(
    name: str,
    start: Vector,
    along: Vector,
    front: Vector,
    lengths: list[float],
    radii: FloatArray,
) -> tuple[Bone, ...]:
    """Three bones, `name`_1 to `name`_3, turned by joints of the same names."""
    pieces = [
        (
            f"{name}_{k + 1}",
            f"{name}_{k + 1}",
            lengths[k],
            (float(radii[k]), float(radii[k + 1])),
        )
        for k in range(3)
    ]
    return limb("palm" if name == "thumb" else "knuckles", start, along, front, pieces)


def curl(
    fingers: tuple[str, ...], bends: tuple[float, float, float]
) -> dict[str, Vector]:
    """The same bends of the three joints of some fingers."""
    return turn(
        **{
            f"{finger}_{k + 1}": bend
            for finger in fingers
            for k, bend in enumerate(bends)
        }
    )


POSES: dict[str, Pose] = {
    "open": Pose({}),
    "relaxed": Pose(curl(FINGERS, (22, 28, 16)) | turn(thumb_2=12)),
    "flex": Pose(turn(wrist=52) | curl(FINGERS, (18, 30, 18))),
}
