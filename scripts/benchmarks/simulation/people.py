"""People: a skeleton of adult proportions.

The numbers in the functions that build the skeleton are positions in metres and fractions of the measures.
They were chosen by eye.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from benchmarks.simulation.skeleton import (
    COLLINEAR,
    Bone,
    Contact,
    Pose,
    RoundCone,
    Vector,
    both,
    left,
    limb,
    mirrored,
    right,
    turn,
    vector,
)
from pcretrieve.values import FloatArray

# Mean, in metres except for the factor "build", and standard deviation relative to the mean: rounded figures
# of adults of both sexes. The stature is the sum of the parts.
MEASURES: dict[str, tuple[float, float]] = {
    "torso": (0.54, 0.06),  # hip joint to shoulder
    "neck": (0.11, 0.15),
    "head": (0.092, 0.07),  # radius of the skull
    "shoulders": (0.185, 0.08),  # joint to midline
    "hips": (0.09, 0.08),  # joint to midline
    "upper_arm": (0.28, 0.07),
    "forearm": (0.25, 0.07),
    "hand": (0.175, 0.07),
    "thigh": (0.42, 0.07),
    "calf": (0.41, 0.07),
    "foot": (0.24, 0.07),
    "build": (1.0, 0.08),  # factor of all girths that follow
    "chest_girth": (0.155, 0.05),  # half width
    "waist_girth": (0.135, 0.10),  # half width
    "hip_girth": (0.160, 0.06),  # half width
    "belly": (0.085, 0.15),  # radius
    "arm_girth": (0.047, 0.08),  # radius
    "leg_girth": (0.080, 0.07),  # radius
}

GIRTHS = ("chest_girth", "waist_girth", "hip_girth", "belly", "arm_girth", "leg_girth")

# Edge of the grid cells of the skin: half of the thickness of the thumb, the thinnest part; m.
CELL = 0.018

# From ankle to sole; m.
ANKLE = 0.08

# At rest the arms point away from the body, half way between raised and lowered arms, which bends the skin
# least; arms and legs are far enough apart for no fillet to join them.
ARM: Vector = (0.78, -0.62, 0.0)
LEG: Vector = (0.11, -0.99, 0.0)
FRONT: Vector = (0.0, 0.0, 1.0)
UP: Vector = (0.0, 1.0, 0.0)


def skeleton(measures: Mapping[str, float]) -> tuple[Bone, ...]:
    """Bones and flesh of a person."""
    build = measures["build"]
    m = {
        name: value * build if name in GIRTHS else value
        for name, value in measures.items()
    }
    m["hip_height"] = m["thigh"] + m["calf"] + ANKLE
    left = _arm(m) + _leg(m)
    return _trunk(m) + left + tuple(mirrored(bone) for bone in left)


def _trunk(m: Mapping[str, float]) -> tuple[Bone, ...]:
    # Hips, loins, waist, chest, shoulders.
    y = m["hip_height"] + m["torso"] * np.array([0.0, 0.22, 0.42, 0.72, 1.0])
    chin = float(y[4]) + m["neck"] + 0.03
    skull = m["head"]

    def upright(
        name: str, parent: str | None, k: int, joint: str, flesh: tuple[RoundCone, ...]
    ) -> Bone:
        return Bone(
            name,
            parent,
            (0, float(y[k]), 0),
            (0, float(y[k + 1]), 0),
            FRONT,
            flesh,
            joint,
            share=1 / 3,
        )

    def on_face(
        y: tuple[float, float], z: tuple[float, float], radii: tuple[float, float]
    ) -> RoundCone:
        start, end = (
            (0, chin + up * skull, ahead * skull) for up, ahead in zip(y, z, strict=True)
        )
        return RoundCone(start, end, radii)

    hips, waist, chest = m["hip_girth"], m["waist_girth"], m["chest_girth"]
    pelvis = (
        RoundCone((0, y[0] + 0.03, 0), (0, y[1], 0), (hips, 0.5 * (hips + waist)), 0.66),
        RoundCone(
            (0.07, y[0] - 0.01, -0.045),
            (0.06, y[0] + 0.05, -0.04),
            (0.52 * hips, 0.5 * hips),
        ),
        RoundCone(
            (-0.07, y[0] - 0.01, -0.045),
            (-0.06, y[0] + 0.05, -0.04),
            (0.52 * hips, 0.5 * hips),
        ),
    )
    belly = m["belly"]
    loins = (
        RoundCone(
            (0, y[1], 0), (0, y[2], 0), (0.5 * (hips + waist), waist), 0.70, COLLINEAR
        ),
        RoundCone((0, y[1] - 0.03, 0.035), (0, y[2], 0.03), (belly, belly)),
    )
    ribs = (RoundCone((0, y[2], 0), (0, y[3], 0), (waist, chest), 0.70, COLLINEAR),)
    breast = (
        RoundCone(
            (0, y[3], 0), (0, y[4] - 0.06, 0), (chest, 0.85 * chest), 0.68, COLLINEAR
        ),
        RoundCone((0, y[4] - 0.04, -0.015), (0, y[4] + 0.04, -0.01), (0.085, 0.06), 0.8),
    )
    neck = RoundCone((0, y[4] - 0.02, -0.005), (0, chin + 0.02, 0.005), (0.062, 0.056))
    face = (
        RoundCone(
            (0, chin + 0.95 * skull, -0.01),
            (0, chin + 1.25 * skull, -0.012),
            (skull, 0.97 * skull),
        ),
        on_face((0.55, 0.9), (0.2, 0.2), (0.6 * skull, 0.7 * skull)),
        on_face((0.85, 1.1), (0.95, 0.85), (0.017, 0.014)),
    )
    return (
        Bone("pelvis", None, (0, y[0], 0), (0, y[1], 0), FRONT, pelvis, "pelvis"),
        upright("loins", "pelvis", 1, "spine", loins),
        upright("ribs", "loins", 2, "spine", ribs),
        upright("breast", "ribs", 3, "spine", breast),
        Bone(
            "neck",
            "breast",
            (0, y[4] - 0.01, -0.01),
            (0, chin, 0),
            FRONT,
            (neck,),
            "neck",
            share=0.5,
        ),
        Bone(
            "head",
            "neck",
            (0, chin, 0),
            (0, chin + 2 * skull, 0),
            FRONT,
            face,
            "neck",
            share=0.5,
        ),
    )


def _arm(m: Mapping[str, float]) -> tuple[Bone, ...]:
    top = m["hip_height"] + m["torso"] - 0.03
    girth = m["arm_girth"]
    x = m["shoulders"]
    shoulder: Vector = (x, top, 0)
    yoke = RoundCone(
        (0.05, top + 0.005, -0.01), (x - 0.02, top - 0.005, 0), (0.065, 1.2 * girth)
    )
    clavicle = Bone(
        "left_clavicle",
        "breast",
        (0.03, top, 0),
        shoulder,
        FRONT,
        (yoke,),
        "left_clavicle",
    )
    pieces = (
        ("left_shoulder", "left_upper_arm", m["upper_arm"], (1.15 * girth, 0.88 * girth)),
        ("left_elbow", "left_forearm", m["forearm"], (0.90 * girth, 0.60 * girth)),
    )
    arm = limb(clavicle.name, shoulder, ARM, FRONT, pieces)
    return (clavicle, *arm, *_hand(m, arm[-1]))


def _hand(m: Mapping[str, float], forearm: Bone) -> tuple[Bone, ...]:
    """Palm, mitten of four fingers, thumb. The palm faces the front, the thumb points up."""
    length, along = m["hand"], np.array(ARM) / np.linalg.norm(ARM)
    thumbwards = np.array(UP) - (np.array(UP) @ along) * along
    thumbwards /= np.linalg.norm(thumbwards)
    wrist = np.array(forearm.tail)
    knuckles, tips = wrist + 0.52 * length * along, wrist + 0.93 * length * along
    width = 0.22 * length

    def lens(
        start: FloatArray, end: FloatArray, radii: tuple[float, float], depth: float
    ) -> RoundCone:
        return RoundCone(vector(start), vector(end), radii, depth)

    palm = lens(wrist + 0.1 * length * along, knuckles, (0.80 * width, width), 0.45)
    fingers = lens(knuckles, tips - 0.12 * length * along, (width, 0.75 * width), 0.40)
    base = wrist + 0.18 * length * along + 0.4 * width * thumbwards
    tip = base + 0.30 * length * (0.80 * along + 0.60 * thumbwards)
    thumb = lens(base, tip, (0.34 * width, 0.30 * width), 1.0)

    def bone(
        name: str, parent: str, start: FloatArray, end: FloatArray, flesh: RoundCone
    ) -> Bone:
        return Bone(
            f"left_{name}",
            parent,
            vector(start),
            vector(end),
            FRONT,
            (flesh,),
            f"left_{name}",
        )

    return (
        bone("hand", forearm.name, wrist, knuckles, palm),
        bone("fingers", "left_hand", knuckles, tips, fingers),
        bone("thumb", "left_hand", base, tip, thumb),
    )


def _leg(m: Mapping[str, float]) -> tuple[Bone, ...]:
    girth = m["leg_girth"]
    pieces = (
        ("left_hip", "left_thigh", m["thigh"], (girth, 0.66 * girth)),
        ("left_knee", "left_calf", m["calf"], (0.64 * girth, 0.44 * girth)),
    )
    *upper, calf = limb(
        "pelvis", np.array([m["hips"], m["hip_height"], 0.0]), LEG, FRONT, pieces
    )
    start, end = np.array(calf.head), np.array(calf.tail)
    belly = RoundCone(
        vector(start + 0.15 * (end - start) - [0, 0, 0.015]),
        vector(start + 0.45 * (end - start) - [0, 0, 0.012]),
        (0.62 * girth, 0.56 * girth),
    )
    calf = replace(calf, flesh=(*calf.flesh, belly))
    x, y, z = calf.tail
    heel, toe = (x, y - 0.025, z - 0.02), (x + 0.02, y - 0.045, z + 0.72 * m["foot"])
    sole = RoundCone(heel, toe, (0.042, 0.038), 0.75)
    instep = RoundCone(
        calf.tail, (x + 0.01, y - 0.03, z + 0.4 * m["foot"]), (0.45 * girth, 0.036)
    )
    foot = Bone("left_foot", calf.name, calf.tail, toe, UP, (sole, instep), "left_foot")
    return (*upper, calf, foot)


_ARMS_DOWN = both(shoulder=(0, -32, 0), elbow=12)

POSES: dict[str, Pose] = {
    "stand": Pose(_ARMS_DOWN),
    "walk": Pose(
        left(shoulder=(28, -30, 0), elbow=14, hip=(-18, -4, 0), knee=-18)
        | right(shoulder=(-25, -30, 0), elbow=30, hip=(28, -4, 0), knee=-12)
    ),
    "run": Pose(
        both(elbow=85)
        | left(shoulder=(38, -32, 0), hip=(-24, -5, 0), knee=-75)
        | right(shoulder=(-38, -28, 0), hip=(62, -5, 0), knee=-70)
        | turn(spine=(14, 0, 8), neck=-8)
    ),
    "sit": Pose(
        both(hip=(88, 4, 0), knee=-86, shoulder=(38, -36, 0), elbow=42) | turn(spine=8)
    ),
    "wave": Pose(
        _ARMS_DOWN | right(shoulder=(5, 30, 0), elbow=(8, 88, 0)) | turn(neck=(0, -10, 0))
    ),
    "point": Pose(
        _ARMS_DOWN | right(clavicle=15, shoulder=(78, 5, 0)) | turn(neck=(0, 0, -20))
    ),
    "lunge": Pose(
        both(shoulder=(5, 20, 0)) | left(hip=75, knee=-80) | right(hip=-32, knee=-28)
    ),
    "hands_on_hips": Pose(
        both(shoulder=(-12, -8, 25), elbow=(82, -25, 0), hand=20),
        contacts=tuple(
            Contact(
                (f"{side}_hand",),
                ("pelvis", "loins"),
                (f"{side}_shoulder", f"{side}_elbow"),
            )
            for side in ("left", "right")
        ),
    ),
}
