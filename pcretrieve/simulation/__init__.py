"""Simulated scans of articulated bodies, for samples, tests and benchmarks.

In come a seed and options; out come triangle meshes of people, animals and hands in many poses, and their
virtual scans as point clouds and files.
"""

from pcretrieve.simulation.bodies import POSES, body, make_subject
from pcretrieve.simulation.damage import DamageOptions, damaged
from pcretrieve.simulation.files import write_conf, write_pcd, write_ply
from pcretrieve.simulation.rig import RigOptions, camera_pose, scan, scan_views
from pcretrieve.simulation.skeleton import Bone, Contact, Pose, RoundCone, Subject
from pcretrieve.simulation.support import SEATED, on_support
from pcretrieve.simulation.turning import TurningOptions, turning_frames, write_frames
from pcretrieve.simulation.uniform import UniformOptions, scan_uniformly

__all__ = [
    "POSES",
    "SEATED",
    "Bone",
    "Contact",
    "DamageOptions",
    "Pose",
    "RigOptions",
    "RoundCone",
    "Subject",
    "TurningOptions",
    "UniformOptions",
    "body",
    "camera_pose",
    "damaged",
    "make_subject",
    "on_support",
    "scan",
    "scan_uniformly",
    "scan_views",
    "turning_frames",
    "write_conf",
    "write_frames",
    "write_pcd",
    "write_ply",
]
