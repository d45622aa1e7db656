"""Simulate the sample scans: simulated bodies, scanned by a virtual scanner, some of them view by view.

Equal seeds give equal points up to rounding errors, and equal files on one machine with equal libraries.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click
import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.measuring import argument_parser
from benchmarks.poses import POSES, SAMPLES, SUBJECTS
from benchmarks.simulation import RigOptions, camera_pose, scan_views
from benchmarks.simulation.samples import SEED, moved, write_samples, write_whole
from pcretrieve.values import FloatArray, TriangleMesh
from pcretrieve.values.files import write_file

EPILOG = """example:
  scripts/make_scans --out scans
  scripts/make_scans --out elsewhere --seed 8 --only person-1_walk
"""

# Subjects on a turntable, whose views are files of their own.
ON_TURNTABLE = ("person-4", "animal-2", "hand-2")

# Standard deviation of the error of a turntable between two views; m.
SLIP = 0.005


def main(arguments: Sequence[str] | None = None) -> None:
    """Simulate all sample scans, or some of them."""
    parser = argument_parser(__doc__, EPILOG)
    add = parser.add_argument
    add(
        "--out",
        type=Path,
        default=Path("scans"),
        help="folder to write to (default: %(default)s)",
    )
    add(
        "--seed",
        type=int,
        default=SEED,
        help="seed of all random numbers (default: %(default)s)",
    )
    add(
        "--only",
        action="append",
        metavar="SCAN",
        choices=SAMPLES,
        help="make this scan only; may be repeated",
    )
    given = parser.parse_args(arguments)
    write_samples(
        given.out,
        given.only or SAMPLES,
        subjects=SUBJECTS,
        poses=POSES,
        seed=given.seed,
        on_scan=lambda path: click.echo(path, err=True),
        write=write,
    )


def write(
    path: Path, surface: TriangleMesh, placed: FloatArray, rng: np.random.Generator
) -> Path:
    """Scan a body as its subject is scanned in the sample set."""
    scanned = write_views if path.parent.name in ON_TURNTABLE else write_whole
    return scanned(path, surface, placed, rng)


def write_views(
    path: Path, surface: TriangleMesh, placed: FloatArray, rng: np.random.Generator
) -> Path:
    """Write the views of a body on a turntable, each in the frame of the scanner, and their poses.

    placed: (4, 4) float64, rigid motion from the frame of the body to the common frame of the views.
    """
    rig = RigOptions()
    names, motions = [], []
    for view, cloud in enumerate(scan_views(surface, rig, rng)):
        to_body = np.eye(4)
        to_body[:3, :3] = Rotation.from_euler(
            "y", 360 * view / rig.n_views, degrees=True
        ).as_matrix()
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


def write_pcd(
    path: Path, points: FloatArray, viewpoint: FloatArray, orientation: Rotation
) -> None:
    """Write points as a PCD file, with the position (3,) and the orientation of the sensor."""
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
        lines.append(
            " ".join(
                ["bmesh", name, *(f"{value:.9g}" for value in (*motion[:3, 3], *inverse))]
            )
        )
    write_file(path, ("\n".join(lines) + "\n").encode())
