"""Simulate the sample scans: simulated bodies, scanned by a virtual scanner.

Equal seeds give equal points up to rounding errors; and equal files on one machine with equal versions of
numpy, scipy, scikit-image and Open3D.
"""

from __future__ import annotations

import argparse
import csv
import io
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
from scipy.spatial.transform import Rotation

from pcretrieve.errors import OptionError
from pcretrieve.simulation.bodies import POSES, body, make_subject
from pcretrieve.simulation.scanner import RigOptions, camera_pose, scan, scan_views
from pcretrieve.values import FloatArray, TriangleMesh
from pcretrieve.values.files import write_file

EPILOG = """example:
  scripts/make_scans --out scans
  scripts/make_scans --out elsewhere --seed 8 --only person-1_walk
"""

SEED = 2016

# Standard deviation of the error of a turntable between two views, and largest coordinates of the origin of
# the frame of the scanner; m.
SLIP = 0.005
ORIGIN = 1.0


@dataclass(frozen=True)
class SampleSubject:
    """One individual of the sample set."""

    name: str
    family: str
    poses: tuple[str, ...]
    views: bool = False


SUBJECTS = (
    SampleSubject("person-1", "person", ("stand", "walk", "sit", "reach_up", "hands_on_hips")),
    SampleSubject("person-2", "person", ("stand", "run", "bow", "wave", "arms_crossed")),
    SampleSubject("person-3", "person", ("walk", "lunge", "point", "kick", "attention")),
    SampleSubject("person-4", "person", ("stand", "cross", "sit", "run", "crouch"), views=True),
    SampleSubject("animal-1", "animal", ("stand", "walk", "graze", "play_bow", "wipe")),
    SampleSubject("animal-2", "animal", ("stand", "gallop", "look_back", "rear", "lie"), views=True),
    SampleSubject("hand-1", "hand", ("open", "relaxed", "grasp", "flex", "fist")),
    SampleSubject("hand-2", "hand", ("spread", "table", "fan", "wave", "together"), views=True),
)

SAMPLES = tuple(f"{subject.name}_{pose}" for subject in SUBJECTS for pose in subject.poses)
"""Names of all sample scans: subject and pose."""

DEMO_SAMPLES = (
    *("person-1_stand", "person-1_walk", "person-1_sit"),
    *("person-2_stand", "person-2_run", "person-2_wave"),
    *("person-3_walk", "person-3_lunge", "person-3_point"),
    *("animal-1_stand", "animal-1_walk", "animal-1_graze"),
    *("hand-1_open", "hand-1_relaxed", "hand-1_flex"),
)
"""Sample scans of a catalogue that is made in about a minute."""

DEMO_QUERY = "person-1_hands_on_hips"
"""A sample scan of one of the same subjects, in a pose with contacts."""


def write_samples(
    folder: Path,
    names: Collection[str] = SAMPLES,
    *,
    seed: int = SEED,
    on_scan: Callable[[Path], object] = lambda path: None,
) -> dict[str, str]:
    """Simulate sample scans, and write the scans, and ``labels.csv`` with their classes."""
    if unknown := sorted(set(names) - set(SAMPLES)):
        raise OptionError(
            f"sample scans must have names of the set, got {', '.join(unknown)}: known are "
            f"{', '.join(SAMPLES)}"
        )
    folder.mkdir(parents=True, exist_ok=True)
    labels = {}
    for number, subject in enumerate(SUBJECTS, start=1):
        for take, pose in enumerate(subject.poses, start=1):
            if f"{subject.name}_{pose}" in names:
                path = _write_sample(folder, subject, pose, seeds=(seed, number, take))
                labels[path.relative_to(folder).as_posix()] = subject.name
                on_scan(path)
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows([("file", "class"), *labels.items()])
    write_file(folder / "labels.csv", text.getvalue().encode())
    return labels


def main(arguments: Sequence[str] | None = None) -> None:
    """Simulate all sample scans, or some of them."""
    parser = argparse.ArgumentParser(
        description=__doc__, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--out", type=Path, default=Path("scans"), help="folder to write to (default: %(default)s)"
    )
    parser.add_argument(
        "--seed", type=int, default=SEED, help="seed of all random numbers (default: %(default)s)"
    )
    parser.add_argument(
        "--only", action="append", metavar="SCAN", help="make this scan only; may be repeated"
    )
    given = parser.parse_args(arguments)
    try:
        write_samples(
            given.out,
            given.only or SAMPLES,
            seed=given.seed,
            on_scan=lambda path: click.echo(path, err=True),
        )
    except OptionError as error:
        parser.error(f"--only: {error.message}")


def _write_sample(folder: Path, subject: SampleSubject, pose: str, *, seeds: tuple[int, int, int]) -> Path:
    """Scan one subject in one pose, and return the file of the scan."""
    # Each scan has a random generator of its own, so that it does not depend on other scans.
    individual = make_subject(subject.family, np.random.default_rng(seeds[:2]))
    rng = np.random.default_rng(seeds)
    surface = body(individual, POSES[subject.family][pose], rng)
    path = folder / subject.name / f"{subject.name}_{pose}"
    path.parent.mkdir(exist_ok=True)
    placed = random_motion(rng)
    if subject.views:
        return write_views(path, surface, placed, rng)
    points = moved(placed, scan(surface, RigOptions(), rng).points)
    write_ply(path.with_suffix(".ply"), points)
    return path.with_suffix(".ply")


def write_views(path: Path, surface: TriangleMesh, placed: FloatArray, rng: np.random.Generator) -> Path:
    """Write the views of a body on a turntable, each in the frame of the scanner, and their poses.

    placed: (4, 4) float64, rigid motion from the frame of the body to the common frame of the views.
    """
    rig = RigOptions()
    names, motions = [], []
    for view, cloud in enumerate(scan_views(surface, rig, rng)):
        to_body = np.eye(4)
        to_body[:3, :3] = Rotation.from_euler("y", 360 * view / rig.n_views, degrees=True).as_matrix()
        to_body[:3, 3] = surface.vertices.mean(axis=0) + rng.normal(0, SLIP, 3)
        to_scanner = np.linalg.inv(to_body).astype(np.float64)
        camera = to_scanner @ camera_pose(surface, rig, view)
        names.append(f"{path.name}_view{view}.pcd")
        motions.append(placed @ to_body)
        write_pcd(
            path.parent / names[-1],
            moved(to_scanner, cloud.points),
            camera[:3, 3],
            Rotation.from_matrix(camera[:3, :3]),
        )
    write_conf(path.with_suffix(".conf"), names, np.array(motions))
    return path.with_suffix(".conf")


def random_motion(rng: np.random.Generator) -> FloatArray:
    """A random rotation and translation, (4, 4): the frame of a scanner may have any orientation."""
    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_quat(rng.standard_normal(4)).as_matrix()
    motion[:3, 3] = rng.uniform(-ORIGIN, ORIGIN, 3)
    return motion


def moved(motion: FloatArray, points: FloatArray) -> FloatArray:
    """(n, 3) points after a rigid motion."""
    there: FloatArray = points @ motion[:3, :3].T + motion[:3, 3]
    return there


def write_ply(path: Path, points: FloatArray) -> None:
    """Write points as a PLY file.

    points: (n, 3) float64, in any unit.
    """
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(points)}\n"
        "property float x\nproperty float y\nproperty float z\nend_header\n"
    )
    write_file(path, header.encode() + points.astype("<f4").tobytes())


def write_pcd(path: Path, points: FloatArray, viewpoint: FloatArray, orientation: Rotation) -> None:
    """Write points as a PCD file, with the pose of the sensor.

    points: (n, 3) float64, in any unit.
    viewpoint: (3,) float64, position of the sensor in the frame of the points.
    """
    pose = [*viewpoint, *orientation.as_quat(canonical=True)[[3, 0, 1, 2]]]  # w first
    header = (
        "# .PCD v0.7 - Point Cloud Data file format\n"
        "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
        f"WIDTH {len(points)}\nHEIGHT 1\n"
        f"VIEWPOINT {' '.join(f'{value:.9g}' for value in pose)}\n"
        f"POINTS {len(points)}\nDATA binary\n"
    )
    write_file(path, header.encode() + points.astype("<f4").tobytes())


def write_conf(path: Path, names: Sequence[str], motions: FloatArray) -> None:
    """Write a Stanford ``.conf`` file: the poses of the range scans of one body.

    motions: (v, 4, 4) float64, rigid motion of each scan to the common frame. Its line ``bmesh name tx ty tz
        qx qy qz qw`` has the translation, and the quaternion of the *inverse* of the rotation, as in the
        Stanford repository.
    """
    lines = []
    for name, motion in zip(names, motions, strict=True):
        inverse = Rotation.from_matrix(motion[:3, :3]).inv().as_quat(canonical=True)
        lines.append(" ".join(["bmesh", name, *(f"{value:.9g}" for value in (*motion[:3, 3], *inverse))]))
    write_file(path, ("\n".join(lines) + "\n").encode())
