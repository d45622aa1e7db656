"""Simulated scans of articulated bodies, for samples, tests and benchmarks.

In come a seed and options; out come triangle meshes of people in many poses, and their
virtual scans as point clouds and files.
"""

from pcretrieve.simulation.bodies import POSES, body, make_subject
from pcretrieve.simulation.samples import write_ply
from pcretrieve.simulation.scanner import RigOptions, camera_pose, scan, scan_views

__all__ = [
    "POSES",
    "RigOptions",
    "body",
    "camera_pose",
    "make_subject",
    "scan",
    "scan_views",
    "write_ply",
]
