"""Four-legged animals, from cat to horse in their proportions, and their poses.

The numbers in the functions that build the skeleton are positions in metres and fractions of the measures.
They were chosen by eye.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from pcretrieve.simulation.skeleton import (
    COLLINEAR,
    Bone,
    Contact,
    Pose,
    RoundCone,
    Vector,
    both,
    limb,
    mirrored,
)

__all__ = ["CELL", "MEASURES", "POSES", "skeleton"]

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
    return _trunk(measures) + _tail(measures) + left + tuple(mirrored(bone) for bone in left)


def _trunk(m: Mapping[str, float]) -> tuple[Bone, ...]:
    back, loins, chest = -0.08, m["loin_girth"] / TALL, m["chest_girth"] / TALL
    z = [back + share * m["trunk"] for share in (0.0, 0.28, 0.52, 0.76, 1.0)]
    shoulder = z[4]

    def lying(name: str, parent: str | None, k: int, joint: str, radii: tuple[float, float]) -> Bone:
        flesh = RoundCone((0, 0, z[k]), (0, 0, z[k + 1]), radii, TALL, COLLINEAR)
        share = 1.0 if parent is None else 1 / 3
        return Bone(name, parent, (0, 0, z[k]), (0, 0, z[k + 1]), DOWN, (flesh,), joint, share)

    nape: Vector = (0, 0.04, shoulder + 0.02)
    rise = 0.70 * m["neck"] + 0.05
    throat: Vector = (0, nape[1] + rise, nape[2] + rise)
    skull = m["skull"]
    brow: Vector = (0, throat[1] + 0.25 * skull, throat[2] + 0.75 * skull)
    nose: Vector = (0, brow[1] - 0.45 * m["muzzle"], brow[2] + 0.5 * skull + m["muzzle"])
    girth = m["neck_girth"]
    face = (
        RoundCone(throat, brow, (0.9 * girth, skull)),
        RoundCone(brow, nose, (0.66 * skull, 0.40 * skull)),
        *(
            RoundCone(
                (side * 0.6 * skull, brow[1] + 0.6 * skull, brow[2] - 0.4 * skull),
                (
                    side * (0.6 * skull + 0.4 * m["ears"]),
                    brow[1] + 0.6 * skull + m["ears"],
                    brow[2] - 0.5 * skull,
                ),
                (0.030, 0.017),
            )
            for side in (1, -1)
        ),
    )
    middle: Vector = (0, nape[1] + rise / 2, nape[2] + rise / 2)
    return (
        lying("pelvis", None, 0, "pelvis", (loins, loins)),
        lying("loins", "pelvis", 1, "spine", (loins, 0.5 * (loins + chest))),
        lying("ribs", "loins", 2, "spine", (0.5 * (loins + chest), chest)),
        lying("breast", "ribs", 3, "spine", (chest, 0.85 * chest)),
        Bone(
            "nape",
            "breast",
            nape,
            middle,
            DOWN,
            (RoundCone(nape, middle, (1.35 * girth, 1.1 * girth)),),
            "neck",
            0.5,
        ),
        Bone(
            "neck",
            "nape",
            middle,
            throat,
            DOWN,
            (RoundCone(middle, throat, (1.1 * girth, girth)),),
            "neck",
            0.5,
        ),
        Bone("head", "neck", throat, nose, DOWN, face, "head"),
    )


def _tail(m: Mapping[str, float]) -> tuple[Bone, ...]:
    root, step, girth = (0.0, 0.03, -0.08 - 0.7 * m["loin_girth"]), m["tail"] / TAIL_BONES, m["tail_girth"]
    bones, parent = [], "pelvis"
    for k in range(TAIL_BONES):
        head: Vector = (0, root[1] - 0.6 * step * k, root[2] - 0.8 * step * k)
        tail: Vector = (0, head[1] - 0.6 * step, head[2] - 0.8 * step)
        radii = (girth * (1 - 0.1 * k), girth * (0.9 - 0.1 * k))
        bones.append(
            Bone(
                f"tail_{k}",
                parent,
                head,
                tail,
                DOWN,
                (RoundCone(head, tail, radii, fillet=COLLINEAR if k else 0.7),),
                "tail",
                1 / TAIL_BONES,
            )
        )
        parent = f"tail_{k}"
    return tuple(bones)


def _hind_leg(m: Mapping[str, float]) -> tuple[Bone, ...]:
    girth = m["leg_girth"]
    leg = limb(
        "pelvis",
        (0.62 * m["loin_girth"], -0.02, -0.06),
        LEG,
        AHEAD,
        (
            ("left_hip", "left_thigh", m["hind_upper"], (1.5 * girth, 0.85 * girth)),
            ("left_knee", "left_shank", m["hind_lower"], (0.85 * girth, 0.5 * girth)),
            ("left_hock", "left_hind_foot", m["hind_foot"], (0.5 * girth, 0.55 * girth)),
        ),
    )
    return (*leg[:-1], _with_paw(leg[-1], girth))


def _fore_leg(m: Mapping[str, float]) -> tuple[Bone, ...]:
    girth = m["leg_girth"]
    leg = limb(
        "breast",
        (0.62 * m["chest_girth"], -0.03, -0.08 + 0.96 * m["trunk"]),
        LEG,
        AHEAD,
        (
            ("left_shoulder", "left_upper_arm", m["fore_upper"], (1.25 * girth, 0.75 * girth)),
            ("left_elbow", "left_forearm", m["fore_lower"], (0.75 * girth, 0.5 * girth)),
            ("left_wrist", "left_fore_foot", m["fore_foot"], (0.5 * girth, 0.55 * girth)),
        ),
    )
    return (*leg[:-1], _with_paw(leg[-1], girth))


def _with_paw(foot: Bone, girth: float) -> Bone:
    x, y, z = foot.tail
    paw = RoundCone(foot.tail, (x, y - 0.008, z + 0.9 * girth), (0.55 * girth, 0.48 * girth))
    return replace(foot, flesh=(*foot.flesh, paw))


_HIND = both(hip=(22, 0, 0), knee=(-48, 0, 0), hock=(34, 0, 0))
_FORE = both(shoulder=(-20, 0, 0), elbow=(26, 0, 0), wrist=(-8, 0, 0))
_STAND = _HIND | _FORE | {"tail": (20, 0, 0)}
_FOLDED_HIND = both(hip=(98, 8, 0), knee=(-112, 0, 0), hock=(92, 0, 0))

POSES: dict[str, Pose] = {
    "stand": Pose(_STAND),
    "walk": Pose(
        _STAND
        | {
            "left_hip": (42, 0, 0),
            "left_knee": (-46, 0, 0),
            "right_hip": (-8, 0, 0),
            "right_knee": (-34, 0, 0),
            "left_shoulder": (-44, 0, 0),
            "left_elbow": (30, 0, 0),
            "right_shoulder": (8, 0, 0),
            "right_elbow": (14, 0, 0),
            "neck": (12, 0, 0),
        }
    ),
    "trot": Pose(
        _STAND
        | {
            "left_hip": (55, 0, 0),
            "left_knee": (-70, 0, 0),
            "left_hock": (55, 0, 0),
            "right_hip": (-14, 0, 0),
            "right_knee": (-20, 0, 0),
            "right_shoulder": (30, 0, 0),
            "right_elbow": (30, 0, 0),
            "right_wrist": (-45, 0, 0),
            "left_shoulder": (-42, 0, 0),
            "tail": (-40, 0, 0),
        }
    ),
    "gallop": Pose(
        both(hip=(-38, 0, 0), knee=(-18, 0, 0), hock=(8, 0, 0), shoulder=(58, 0, 0), elbow=(4, 0, 0))
        | {"spine": (-24, 0, 0), "neck": (22, 0, 0), "tail": (-50, 0, 0)}
    ),
    "gather": Pose(
        both(hip=(72, 0, 0), knee=(-50, 0, 0), hock=(25, 0, 0), shoulder=(-52, 0, 0), elbow=(25, 0, 0))
        | {"spine": (45, 0, 0), "neck": (-42, 0, 0), "tail": (-30, 0, 0)}
    ),
    "graze": Pose(_STAND | {"neck": (78, 0, 0), "head": (28, 0, 0), "spine": (8, 0, 0)}),
    "look_up": Pose(_STAND | {"neck": (-28, 0, 0), "head": (-38, 0, 0), "tail": (-70, 0, 0)}),
    "look_back": Pose(
        _STAND | {"neck": (0, 70, 0), "head": (0, 30, 0), "spine": (0, 30, 0), "tail": (0, 50, 0)}
    ),
    "rear": Pose(
        both(
            hip=(-22, 0, 0),
            knee=(-52, 0, 0),
            hock=(36, 0, 0),
            shoulder=(30, 0, 0),
            elbow=(75, 0, 0),
            wrist=(-50, 0, 0),
        )
        | {"pelvis": (-52, 0, 0), "spine": (-16, 0, 0), "neck": (25, 0, 0)}
    ),
    "play_bow": Pose(
        _HIND
        | both(shoulder=(52, 6, 0), elbow=(28, 0, 0), wrist=(-6, 0, 0))
        | {"pelvis": (22, 0, 0), "spine": (-18, 0, 0), "neck": (-22, 0, 0), "tail": (-95, 0, 0)}
    ),
    "sit": Pose(
        _FOLDED_HIND
        | both(shoulder=(-28, 0, 0), elbow=(22, 0, 0), wrist=(-8, 0, 0))
        | {"pelvis": (-46, 0, 0), "neck": (30, 0, 0), "tail": (-25, 0, 0)}
    ),
    "lie": Pose(
        _FOLDED_HIND
        | both(shoulder=(-42, 4, 0), elbow=(100, 0, 0), wrist=(-4, 0, 0))
        | {"tail": (10, 25, 0)},
        contacts=tuple(
            Contact((f"{side}_shank",), ("loins", "ribs"), (f"{side}_hip",)) for side in ("left", "right")
        ),
    ),
    "legs_together": Pose(
        _STAND | {"neck": (20, 0, 0)},
        contacts=(
            Contact(("left_hind_foot",), ("right_hind_foot",), ("left_hip", "right_hip")),
            Contact(("left_fore_foot",), ("right_fore_foot",), ("left_shoulder", "right_shoulder")),
        ),
    ),
    "wipe": Pose(
        _STAND
        | {
            "left_shoulder": (35, -8, 0),
            "left_elbow": (75, 0, 0),
            "left_wrist": (-30, 0, 0),
            "neck": (50, 0, 0),
        },
        contacts=(Contact(("left_fore_foot",), ("head",), ("left_shoulder", "neck")),),
    ),
    "tail_on_thigh": Pose(
        _STAND | {"tail": (50, 40, 0), "neck": (-10, -25, 0)},
        contacts=(Contact(("tail_3",), ("left_thigh", "left_shank"), ("tail",)),),
    ),
}
