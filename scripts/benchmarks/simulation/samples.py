"""The sample scans: simulated bodies, scanned by a virtual scanner.

Equal seeds give equal points up to rounding errors, and equal files on one machine with equal libraries.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Collection, Mapping
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.simulation.bodies import POSES, body, make_subject
from benchmarks.simulation.scanner import RigOptions, scan
from benchmarks.simulation.skeleton import Pose
from pcretrieve.values import FloatArray, TriangleMesh
from pcretrieve.values.files import write_file

SEED = 2016

# Largest coordinates of the origin of the frame of the scanner; m.
ORIGIN = 1.0

# The poses of each individual of the sample set; its name begins with its family.
SUBJECTS = {
    "person-1": ("stand", "walk", "sit", "reach_up", "hands_on_hips"),
    "person-2": ("stand", "run", "bow", "wave", "arms_crossed"),
    "person-3": ("walk", "lunge", "point", "kick", "attention"),
    "person-4": ("stand", "cross", "sit", "run", "crouch"),
}


def write_whole(
    path: Path, surface: TriangleMesh, placed: FloatArray, rng: np.random.Generator
) -> Path:
    """Write the scan of a body by all cameras, in a frame of its own."""
    points = moved(placed, scan(surface, RigOptions(), rng).points)
    write_ply(path.with_suffix(".ply"), points)
    return path.with_suffix(".ply")


def write_samples(
    folder: Path,
    names: Collection[str],
    *,
    subjects: Mapping[str, Collection[str]] = SUBJECTS,
    poses: Mapping[str, Mapping[str, Pose]] = POSES,
    seed: int = SEED,
    on_scan: Callable[[Path], object] = lambda path: None,
    write: Callable[
        [Path, TriangleMesh, FloatArray, np.random.Generator], Path
    ] = write_whole,
) -> dict[str, str]:
    """Simulate sample scans, and write the scans, and ``labels.csv`` with their classes.

    subjects: the poses of each individual, whose name begins with its family.
    write: what scans a body and writes its file, given a path without suffix, the surface, the motion (4, 4)
        to the frame of the scan, and a generator.
    """
    folder.mkdir(parents=True, exist_ok=True)
    labels = {}
    for number, (subject, names_of_poses) in enumerate(subjects.items(), start=1):
        family = subject.partition("-")[0]
        for take, pose in enumerate(names_of_poses, start=1):
            name = f"{subject}_{pose}"
            if name not in names:
                continue
            (folder / subject).mkdir(exist_ok=True)
            # Each scan has a random generator of its own, so that it does not depend on other scans.
            individual = make_subject(family, np.random.default_rng((seed, number)))
            rng = np.random.default_rng((seed, number, take))
            surface = body(individual, poses[family][pose], rng)
            path = write(folder / subject / name, surface, random_motion(rng), rng)
            labels[path.relative_to(folder).as_posix()] = subject
            on_scan(path)
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows([("file", "class"), *labels.items()])
    write_file(folder / "labels.csv", text.getvalue().encode())
    return labels


def random_motion(rng: np.random.Generator) -> FloatArray:
    """A random rotation and translation, (4, 4): the frame of a scanner may have any orientation."""
    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_quat(rng.standard_normal(4)).as_matrix()
    motion[:3, 3] = rng.uniform(-ORIGIN, ORIGIN, 3)
    return motion


def moved(motion: FloatArray, points: FloatArray) -> FloatArray:
    """(n, 3) points after a rigid motion."""
    return np.asarray(points @ motion[:3, :3].T + motion[:3, 3])


def write_ply(path: Path, points: FloatArray) -> None:
    """Write points as a PLY file, in any unit."""
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(points)}\n"
        "property float x\nproperty float y\nproperty float z\nend_header\n"
    )
    write_file(path, header.encode() + points.astype("<f4").tobytes())
