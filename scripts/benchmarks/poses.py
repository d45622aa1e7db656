"""Poses of the samples, the benchmarks and the shipped arrays: those of the package, and more."""

from __future__ import annotations

from collections.abc import Mapping

from benchmarks import animals, hands
from benchmarks.hands import FINGERS, curl
from benchmarks.simulation import samples
from benchmarks.simulation.bodies import FAMILIES
from benchmarks.simulation.skeleton import Contact, Pose, both, left, right, turn

_ARMS_DOWN = both(shoulder=(0, -32, 0), elbow=12)
_TRUNK = ("pelvis", "loins", "ribs", "breast")

_PERSON: dict[str, Pose] = {
    "cross": Pose(both(shoulder=(0, 36, 0))),
    "reach_up": Pose(both(clavicle=(0, 22, 0), shoulder=(10, 88, 0)) | turn(neck=-12)),
    "bow": Pose(both(hip=38, knee=-6, shoulder=(45, -25, 0)) | turn(spine=52, neck=15)),
    "kick": Pose(
        both(shoulder=(0, 15, 0), elbow=20)
        | left(hip=78, knee=-14)
        | right(knee=-10)
        | turn(spine=-8)
    ),
    "arms_crossed": Pose(
        left(shoulder=(22, -30, 62), elbow=96) | right(shoulder=(36, -22, 62), elbow=96),
        contacts=(
            Contact(("left_forearm", "left_hand"), _TRUNK, ("left_shoulder",)),
            Contact(
                ("right_forearm", "right_hand"),
                ("left_forearm", "left_hand"),
                ("right_shoulder",),
            ),
        ),
    ),
    "hands_clasped": Pose(
        left(shoulder=(34, -32, 58), elbow=66) | right(shoulder=(24, -32, 58), elbow=66),
        contacts=(
            Contact(
                ("left_fingers",), ("right_hand",), ("left_shoulder", "right_shoulder")
            ),
        ),
    ),
    "legs_crossed": Pose(
        both(shoulder=(30, -30, 0), elbow=40)
        | left(hip=(104, -26, 0), knee=-92)
        | right(hip=(86, 2, 0), knee=-84)
        | turn(spine=8),
        contacts=(Contact(("left_thigh", "left_calf"), ("right_thigh",), ("left_hip",)),),
    ),
    "attention": Pose(
        both(shoulder=(0, -42, 0), hip=(0, -6, 0)),
        contacts=(
            Contact(("left_hand", "left_fingers"), ("left_thigh",), ("left_shoulder",)),
            Contact(
                ("right_hand", "right_fingers"), ("right_thigh",), ("right_shoulder",)
            ),
            Contact(("left_calf",), ("right_calf",), ("left_hip", "right_hip")),
        ),
    ),
    "think": Pose(
        _ARMS_DOWN | right(shoulder=(36, -25, 35), elbow=98) | turn(neck=14),
        contacts=(
            Contact(("right_fingers",), ("head",), ("right_shoulder", "right_elbow")),
        ),
    ),
    "crouch": Pose(
        both(hip=(96, 8, 0), knee=-98, foot=22, shoulder=(58, -30, 0), elbow=30)
        | turn(spine=28),
        contacts=tuple(
            Contact(
                (f"{side}_hand",),
                (f"{side}_calf",),
                (f"{side}_shoulder", f"{side}_elbow"),
            )
            for side in ("left", "right")
        ),
    ),
}

_HIND = both(hip=22, knee=-48, hock=34)
_FORE = both(shoulder=-20, elbow=26, wrist=-8)
_STAND = _HIND | _FORE | turn(tail=20)
_FOLDED_HIND = both(hip=(98, 8, 0), knee=-112, hock=92)

_ANIMAL: dict[str, Pose] = {
    "trot": Pose(
        _STAND
        | left(hip=55, knee=-70, hock=55, shoulder=-42)
        | right(hip=-14, knee=-20, shoulder=30, elbow=30, wrist=-45)
        | turn(tail=-40)
    ),
    "gallop": Pose(
        both(hip=-38, knee=-18, hock=8, shoulder=58, elbow=4)
        | turn(spine=-24, neck=22, tail=-50)
    ),
    "gather": Pose(
        both(hip=72, knee=-50, hock=25, shoulder=-52, elbow=25)
        | turn(spine=45, neck=-42, tail=-30)
    ),
    "look_up": Pose(_STAND | turn(neck=-28, head=-38, tail=-70)),
    "look_back": Pose(
        _STAND | turn(neck=(0, 70, 0), head=(0, 30, 0), spine=(0, 30, 0), tail=(0, 50, 0))
    ),
    "rear": Pose(
        both(hip=-22, knee=-52, hock=36, shoulder=30, elbow=75, wrist=-50)
        | turn(pelvis=-52, spine=-16, neck=25)
    ),
    "play_bow": Pose(
        _HIND
        | both(shoulder=(52, 6, 0), elbow=28, wrist=-6)
        | turn(pelvis=22, spine=-18, neck=-22, tail=-95)
    ),
    "sit": Pose(
        _FOLDED_HIND
        | both(shoulder=-28, elbow=22, wrist=-8)
        | turn(pelvis=-46, neck=30, tail=-25)
    ),
    "lie": Pose(
        _FOLDED_HIND
        | both(shoulder=(-42, 4, 0), elbow=100, wrist=-4)
        | turn(tail=(10, 25, 0)),
        contacts=tuple(
            Contact((f"{side}_shank",), ("loins", "ribs"), (f"{side}_hip",))
            for side in ("left", "right")
        ),
    ),
    "legs_together": Pose(
        _STAND | turn(neck=20),
        contacts=(
            Contact(("left_hind_foot",), ("right_hind_foot",), ("left_hip", "right_hip")),
            Contact(
                ("left_fore_foot",),
                ("right_fore_foot",),
                ("left_shoulder", "right_shoulder"),
            ),
        ),
    ),
    "wipe": Pose(
        _STAND | left(shoulder=(35, -8, 0), elbow=75, wrist=-30) | turn(neck=50),
        contacts=(Contact(("left_fore_foot",), ("head",), ("left_shoulder", "neck")),),
    ),
    "tail_on_thigh": Pose(
        _STAND | turn(tail=(50, 40, 0), neck=(-10, -25, 0)),
        contacts=(Contact(("tail_3",), ("left_thigh", "left_shank"), ("tail",)),),
    ),
}


def _on_palm(*fingers: str) -> tuple[Contact, ...]:
    return tuple(
        Contact((f"{finger}_3",), ("palm",), (f"{finger}_1", f"{finger}_2"))
        for finger in fingers
    )


_CLOSED = (80.0, 95.0, 50.0)
_THUMB_IN = turn(thumb_1=24, thumb_2=30, thumb_3=38)
_SIDE_BY_SIDE = (("index", "middle"), ("ring", "middle"), ("little", "ring"))

_HAND: dict[str, Pose] = {
    "spread": Pose(
        turn(
            index_1=(-6, -8, 0),
            ring_1=(-6, 6, 0),
            little_1=(-8, 14, 0),
            thumb_1=(-16, 10, 0),
        )
    ),
    "grasp": Pose(curl(FINGERS, (42, 48, 28)) | turn(thumb_1=20, thumb_2=22)),
    "claw": Pose(curl(FINGERS, (-12, 75, 48)) | turn(thumb_2=30, thumb_3=35)),
    "table": Pose(curl(FINGERS, (78, 6, 4)) | turn(thumb_1=8)),
    "wave": Pose(turn(wrist=(-38, 14, 0)) | curl(FINGERS, (10, 12, 8))),
    "fan": Pose(
        turn(
            index_1=0,
            middle_1=25,
            ring_1=50,
            little_1=72,
            middle_2=15,
            ring_2=32,
            little_2=45,
        )
    ),
    "thumb_out": Pose(curl(FINGERS, (55, 72, 40)) | turn(thumb_1=-14, thumb_3=-10)),
    "fist": Pose(curl(FINGERS, _CLOSED) | _THUMB_IN, contacts=_on_palm(*FINGERS)),
    "point": Pose(
        curl(FINGERS[1:], _CLOSED) | _THUMB_IN,
        contacts=(
            *_on_palm(*FINGERS[1:]),
            Contact(("thumb_3",), ("middle_2", "middle_3"), ("thumb_1",)),
        ),
    ),
    "victory": Pose(
        curl(FINGERS[2:], _CLOSED) | _THUMB_IN,
        contacts=(
            *_on_palm(*FINGERS[2:]),
            Contact(("thumb_3",), ("ring_2", "ring_3"), ("thumb_1",)),
        ),
    ),
    "together": Pose(
        contacts=tuple(
            Contact(
                (f"{finger}_2", f"{finger}_3"),
                (f"{next_to}_2", f"{next_to}_3"),
                (f"{finger}_1",),
            )
            for finger, next_to in _SIDE_BY_SIDE
        )
    ),
    "ring": Pose(
        curl(("index",), (48, 55, 35)) | curl(FINGERS[2:], (10, 15, 8)) | _THUMB_IN,
        contacts=(Contact(("thumb_3",), ("index_3",), ("thumb_1", "index_1")),),
    ),
}

# The order from which subjects take poses in turn: with another one the shipped arrays would be others.
_ORDER = {
    "person": (
        "stand",
        "cross",
        "walk",
        "run",
        "sit",
        "reach_up",
        "wave",
        "bow",
        "point",
        "kick",
        "lunge",
        "hands_on_hips",
        "arms_crossed",
        "hands_clasped",
        "legs_crossed",
        "attention",
        "think",
        "crouch",
    ),
    "animal": (
        "stand",
        "walk",
        "trot",
        "gallop",
        "gather",
        "graze",
        "look_up",
        "look_back",
        "rear",
        "play_bow",
        "sit",
        "lie",
        "legs_together",
        "wipe",
        "tail_on_thigh",
    ),
    "hand": (
        "open",
        "relaxed",
        "spread",
        "grasp",
        "claw",
        "table",
        "wave",
        "flex",
        "fan",
        "thumb_out",
        "fist",
        "point",
        "victory",
        "together",
        "ring",
    ),
}

# Pcretrieve simulates people; samples and benchmarks have animals and hands too.
FAMILIES |= {"animal": animals, "hand": hands}

POSES: Mapping[str, Mapping[str, Pose]] = {
    family: {name: (FAMILIES[family].POSES | more)[name] for name in _ORDER[family]}
    for family, more in (("person", _PERSON), ("animal", _ANIMAL), ("hand", _HAND))
}
"""Poses by family and name. In poses with contacts (`Pose.contacts`) parts of the body touch each other."""

SUBJECTS: Mapping[str, tuple[str, ...]] = {
    **samples.SUBJECTS,
    "animal-1": ("stand", "walk", "graze", "play_bow", "wipe"),
    "animal-2": ("stand", "gallop", "look_back", "rear", "lie"),
    "hand-1": ("open", "relaxed", "grasp", "flex", "fist"),
    "hand-2": ("spread", "table", "fan", "wave", "together"),
}
"""The poses of each individual of the sample set."""

SAMPLES = tuple(
    f"{subject}_{pose}" for subject, poses in SUBJECTS.items() for pose in poses
)
"""Names of all sample scans: subject and pose."""
