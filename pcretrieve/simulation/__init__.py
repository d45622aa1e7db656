"""Simulated scans of bending bodies, for samples, tests and benchmarks. Needs ``pcretrieve[simulation]``."""

from pcretrieve.simulation.bodies import POSES, body, make_subject
from pcretrieve.simulation.damage import DamageOptions, damaged
from pcretrieve.simulation.files import write_conf, write_pcd, write_ply
from pcretrieve.simulation.rig import (
    RigOptions,
    UniformOptions,
    camera_pose,
    scan,
    scan_uniformly,
    scan_views,
)
from pcretrieve.simulation.skeleton import Bone, Contact, Pose, RoundCone, Subject

__all__ = [
    "POSES",
    "Bone",
    "Contact",
    "DamageOptions",
    "Pose",
    "RigOptions",
    "RoundCone",
    "Subject",
    "UniformOptions",
    "body",
    "camera_pose",
    "damaged",
    "make_subject",
    "scan",
    "scan_uniformly",
    "scan_views",
    "write_conf",
    "write_pcd",
    "write_ply",
]
