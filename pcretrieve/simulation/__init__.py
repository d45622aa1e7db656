"""Simulated scans of articulated bodies, for samples, tests and benchmarks.

In come a seed and options; out come triangle meshes of people, animals and hands in many poses, and their
virtual scans as point clouds and files.
"""

from pcretrieve.simulation.bodies import POSES, body, make_subject
from pcretrieve.simulation.samples import write_ply
from pcretrieve.simulation.scanner import RigOptions, camera_pose, scan, scan_views
from pcretrieve.simulation.turning import TurningOptions, turning_frames, write_frames

__all__ = [
    "POSES",
    "RigOptions",
    "TurningOptions",
    "body",
    "camera_pose",
    "make_subject",
    "scan",
    "scan_views",
    "turning_frames",
    "write_frames",
    "write_ply",
]
