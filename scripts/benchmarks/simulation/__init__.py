"""Simulated scans of articulated bodies, for samples, the demo, tests and benchmarks.

In come a seed and options; out come triangle meshes of people in many poses, and their
virtual scans as point clouds and files.
"""

from benchmarks.simulation.bodies import POSES, body, make_subject
from benchmarks.simulation.samples import write_ply
from benchmarks.simulation.scanner import RigOptions, camera_pose, scan, scan_views

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
