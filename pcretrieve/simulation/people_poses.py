"""The poses that people take."""

from __future__ import annotations

from pcretrieve.simulation.limbs import both
from pcretrieve.simulation.skeleton import Contact, Pose

__all__ = ["POSES"]

_ARMS_DOWN = both(shoulder=(0, -32, 0), elbow=(12, 0, 0))
_TRUNK = ("pelvis", "loins", "ribs", "breast")

POSES: dict[str, Pose] = {
    "stand": Pose(_ARMS_DOWN),
    "cross": Pose(both(shoulder=(0, 36, 0))),
    "walk": Pose(
        {
            "left_shoulder": (28, -30, 0),
            "left_elbow": (14, 0, 0),
            "right_shoulder": (-25, -30, 0),
            "right_elbow": (30, 0, 0),
            "left_hip": (-18, -4, 0),
            "left_knee": (-18, 0, 0),
            "right_hip": (28, -4, 0),
            "right_knee": (-12, 0, 0),
        }
    ),
    "run": Pose(
        {
            **both(elbow=(85, 0, 0)),
            "spine": (14, 0, 8),
            "neck": (-8, 0, 0),
            "left_shoulder": (38, -32, 0),
            "right_shoulder": (-38, -28, 0),
            "left_hip": (-24, -5, 0),
            "left_knee": (-75, 0, 0),
            "right_hip": (62, -5, 0),
            "right_knee": (-70, 0, 0),
        }
    ),
    "sit": Pose(
        both(hip=(88, 4, 0), knee=(-86, 0, 0), shoulder=(38, -36, 0), elbow=(42, 0, 0)) | {"spine": (8, 0, 0)}
    ),
    "reach_up": Pose(both(clavicle=(0, 22, 0), shoulder=(10, 88, 0)) | {"neck": (-12, 0, 0)}),
    "wave": Pose(_ARMS_DOWN | {"right_shoulder": (5, 30, 0), "right_elbow": (8, 88, 0), "neck": (0, -10, 0)}),
    "bow": Pose(
        both(hip=(38, 0, 0), knee=(-6, 0, 0), shoulder=(45, -25, 0))
        | {"spine": (52, 0, 0), "neck": (15, 0, 0)}
    ),
    "point": Pose(
        _ARMS_DOWN | {"right_clavicle": (15, 0, 0), "right_shoulder": (78, 5, 0), "neck": (0, 0, -20)}
    ),
    "kick": Pose(
        both(shoulder=(0, 15, 0), elbow=(20, 0, 0))
        | {"left_hip": (78, 0, 0), "left_knee": (-14, 0, 0), "right_knee": (-10, 0, 0), "spine": (-8, 0, 0)}
    ),
    "lunge": Pose(
        both(shoulder=(5, 20, 0))
        | {
            "left_hip": (75, 0, 0),
            "left_knee": (-80, 0, 0),
            "right_hip": (-32, 0, 0),
            "right_knee": (-28, 0, 0),
        }
    ),
    "hands_on_hips": Pose(
        both(shoulder=(-12, -8, 25), elbow=(82, -25, 0), hand=(20, 0, 0)),
        contacts=tuple(
            Contact((f"{side}_hand",), ("pelvis", "loins"), (f"{side}_shoulder", f"{side}_elbow"))
            for side in ("left", "right")
        ),
    ),
    "arms_crossed": Pose(
        {
            "left_shoulder": (22, -30, 62),
            "left_elbow": (96, 0, 0),
            "right_shoulder": (36, -22, 62),
            "right_elbow": (96, 0, 0),
        },
        contacts=(
            Contact(("left_forearm", "left_hand"), _TRUNK, ("left_shoulder",)),
            Contact(("right_forearm", "right_hand"), ("left_forearm", "left_hand"), ("right_shoulder",)),
        ),
    ),
    "hands_clasped": Pose(
        {
            "left_shoulder": (34, -32, 58),
            "left_elbow": (66, 0, 0),
            "right_shoulder": (24, -32, 58),
            "right_elbow": (66, 0, 0),
        },
        contacts=(Contact(("left_fingers",), ("right_hand",), ("left_shoulder", "right_shoulder")),),
    ),
    "legs_crossed": Pose(
        both(shoulder=(30, -30, 0), elbow=(40, 0, 0))
        | {
            "left_hip": (104, -26, 0),
            "left_knee": (-92, 0, 0),
            "right_hip": (86, 2, 0),
            "right_knee": (-84, 0, 0),
            "spine": (8, 0, 0),
        },
        contacts=(Contact(("left_thigh", "left_calf"), ("right_thigh",), ("left_hip",)),),
    ),
    "attention": Pose(
        both(shoulder=(0, -42, 0), hip=(0, -6, 0)),
        contacts=(
            Contact(("left_hand", "left_fingers"), ("left_thigh",), ("left_shoulder",)),
            Contact(("right_hand", "right_fingers"), ("right_thigh",), ("right_shoulder",)),
            Contact(("left_calf",), ("right_calf",), ("left_hip", "right_hip")),
        ),
    ),
    "think": Pose(
        _ARMS_DOWN | {"right_shoulder": (36, -25, 35), "right_elbow": (98, 0, 0), "neck": (14, 0, 0)},
        contacts=(Contact(("right_fingers",), ("head",), ("right_shoulder", "right_elbow")),),
    ),
    "crouch": Pose(
        both(hip=(96, 8, 0), knee=(-98, 0, 0), foot=(22, 0, 0), shoulder=(58, -30, 0), elbow=(30, 0, 0))
        | {"spine": (28, 0, 0)},
        contacts=tuple(
            Contact((f"{side}_hand",), (f"{side}_calf",), (f"{side}_shoulder", f"{side}_elbow"))
            for side in ("left", "right")
        ),
    ),
}
