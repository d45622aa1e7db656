"""Four-legged animals, from cat to horse in their proportions, and their poses.

The numbers in the functions that build the skeleton are positions in metres and fractions of the measures.
They were chosen by eye.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from benchmarks.simulation.skeleton import (
    COLLINEAR,
    Bone,
    Pose,
    RoundCone,
    Vector,
    both,
    left,
    limb,
    mirrored,
    right,
    turn,
)

# Mean in metres, and standard deviation relative to the mean: large, because species differ.
MEASURES: dict[str, tuple[float, float]] = {
    "trunk": (0.62, 0.10),  # hip joint to shoulder
    "neck": (0.24, 0.25),
    "skull": (0.085, 0.12),  # radius
    "muzzle": (0.15, 0.25),
    "ears": (0.10, 0.25),
    "tail": (0.40, 0.25),
    "fore_upper": (0.20, 0.14),
    "fore_lower": (0.22, 0.16),
    "fore_foot": (0.12, 0.12),
    "hind_upper": (0.22, 0.14),
    "hind_lower": (0.22, 0.16),
    "hind_foot": (0.16, 0.12),
    "chest_girth": (0.145, 0.12),  # half height
    "loin_girth": (0.115, 0.14),  # half height
    "neck_girth": (0.075, 0.14),  # radius
    "leg_girth": (0.062, 0.14),  # radius
    "tail_girth": (0.025, 0.15),  # radius
}

# Edge of the grid cells of the skin: half of the thickness of the ears, the thinnest part; m.
CELL = 0.017

AHEAD: Vector = (0.0, 0.0, 1.0)
DOWN: Vector = (0.0, -1.0, 0.0)
# At rest the legs are straight and apart; the pose "stand" bends them.
LEG: Vector = (0.10, -0.99, 0.0)
# Height of the trunk relative to its width.
TALL = 1.2

TAIL_BONES = 4


def skeleton(measures: Mapping[str, float]) -> tuple[Bone, ...]:
    """Bones and flesh of an animal; the hip joints are at the height of the origin."""
    left = _hind_leg(measures) + _fore_leg(measures)
    return (
        _trunk(measures) + _tail(measures) + left + tuple(mirrored(bone) for bone in left)
    )


def _trunk(m: Mapping[str, float]) -> tuple[Bone, ...]:
    back, loins, chest = -0.08, m["loin_girth"] / TALL, m["chest_girth"] / TALL
    z = [back + share * m["trunk"] for share in (0.0, 0.28, 0.52, 0.76, 1.0)]
    shoulder = z[4]

    def lying(
        name: str, parent: str | None, k: int, joint: str, radii: tuple[float, float]
    ) -> Bone:
        flesh = RoundCone((0, 0, z[k]), (0, 0, z[k + 1]), radii, TALL, COLLINEAR)
        share = 1.0 if parent is None else 1 / 3
        return Bone(
            name, parent, (0, 0, z[k]), (0, 0, z[k + 1]), DOWN, (flesh,), joint, share
        )

    nape: Vector = (0, 0.04, shoulder + 0.02)
    rise = 0.70 * m["neck"] + 0.05
    throat: Vector = (0, nape[1] + rise, nape[2] + rise)
    skull = m["skull"]
    brow: Vector = (0, throat[1] + 0.25 * skull, throat[2] + 0.75 * skull)
    nose: Vector = (0, brow[1] - 0.45 * m["muzzle"], brow[2] + 0.5 * skull + m["muzzle"])
    girth = m["neck_girth"]

    def ear(side: int) -> RoundCone:
        x, y = 0.6 * skull, brow[1] + 0.6 * skull
        tip: Vector = (side * (x + 0.4 * m["ears"]), y + m["ears"], brow[2] - 0.5 * skull)
        return RoundCone(
            (side * 0.6 * skull, y, brow[2] - 0.4 * skull), tip, (0.030, 0.017)
        )

    face = (
        RoundCone(throat, brow, (0.9 * girth, skull)),
        RoundCone(brow, nose, (0.66 * skull, 0.40 * skull)),
        ear(1),
        ear(-1),
    )
    middle: Vector = (0, nape[1] + rise / 2, nape[2] + rise / 2)

    def lower(
        name: str, parent: str, start: Vector, end: Vector, radii: tuple[float, float]
    ) -> Bone:
        return Bone(
            name, parent, start, end, DOWN, (RoundCone(start, end, radii),), "neck", 0.5
        )

    return (
        lying("pelvis", None, 0, "pelvis", (loins, loins)),
        lying("loins", "pelvis", 1, "spine", (loins, 0.5 * (loins + chest))),
        lying("ribs", "loins", 2, "spine", (0.5 * (loins + chest), chest)),
        lying("breast", "ribs", 3, "spine", (chest, 0.85 * chest)),
        lower("nape", "breast", nape, middle, (1.35 * girth, 1.1 * girth)),
        lower("neck", "nape", middle, throat, (1.1 * girth, girth)),
        Bone("head", "neck", throat, nose, DOWN, face, "head"),
    )


def _tail(m: Mapping[str, float]) -> tuple[Bone, ...]:
    root, step, girth = (
        (0.0, 0.03, -0.08 - 0.7 * m["loin_girth"]),
        m["tail"] / TAIL_BONES,
        m["tail_girth"],
    )
    bones, parent = [], "pelvis"
    for k in range(TAIL_BONES):
        head: Vector = (0, root[1] - 0.6 * step * k, root[2] - 0.8 * step * k)
        tail: Vector = (0, head[1] - 0.6 * step, head[2] - 0.8 * step)
        radii = (girth * (1 - 0.1 * k), girth * (0.9 - 0.1 * k))
        flesh = RoundCone(head, tail, radii, fillet=COLLINEAR if k else 0.7)
        bones.append(
            Bone(f"tail_{k}", parent, head, tail, DOWN, (flesh,), "tail", 1 / TAIL_BONES)
        )
        parent = f"tail_{k}"
    return tuple(bones)


def _hind_leg(m: Mapping[str, float]) -> tuple[Bone, ...]:
    girth = m["leg_girth"]
    pieces = (
        ("left_hip", "left_thigh", m["hind_upper"], (1.5 * girth, 0.85 * girth)),
        ("left_knee", "left_shank", m["hind_lower"], (0.85 * girth, 0.5 * girth)),
        ("left_hock", "left_hind_foot", m["hind_foot"], (0.5 * girth, 0.55 * girth)),
    )
    leg = limb("pelvis", (0.62 * m["loin_girth"], -0.02, -0.06), LEG, AHEAD, pieces)
    return (*leg[:-1], _with_paw(leg[-1], girth))


def _fore_leg(m: Mapping[str, float]) -> tuple[Bone, ...]:
    girth = m["leg_girth"]
    pieces = (
        (
            "left_shoulder",
            "left_upper_arm",
            m["fore_upper"],
            (1.25 * girth, 0.75 * girth),
        ),
        ("left_elbow", "left_forearm", m["fore_lower"], (0.75 * girth, 0.5 * girth)),
        ("left_wrist", "left_fore_foot", m["fore_foot"], (0.5 * girth, 0.55 * girth)),
    )
    start = (0.62 * m["chest_girth"], -0.03, -0.08 + 0.96 * m["trunk"])
    leg = limb("breast", start, LEG, AHEAD, pieces)
    return (*leg[:-1], _with_paw(leg[-1], girth))


def _with_paw(foot: Bone, girth: float) -> Bone:
    x, y, z = foot.tail
    paw = RoundCone(
        foot.tail, (x, y - 0.008, z + 0.9 * girth), (0.55 * girth, 0.48 * girth)
    )
    return replace(foot, flesh=(*foot.flesh, paw))


_STAND = both(hip=22, knee=-48, hock=34, shoulder=-20, elbow=26, wrist=-8) | turn(tail=20)

POSES: dict[str, Pose] = {
    "stand": Pose(_STAND),
    "walk": Pose(
        _STAND
        | left(hip=42, knee=-46, shoulder=-44, elbow=30)
        | right(hip=-8, knee=-34, shoulder=8, elbow=14)
        | turn(neck=12)
    ),
    "graze": Pose(_STAND | turn(neck=78, head=28, spine=8)),
}
