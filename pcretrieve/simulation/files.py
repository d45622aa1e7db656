"""Scan files as scanners write them: binary, single precision, little-endian."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from scipy.spatial.transform import Rotation

from pcretrieve.atomic import write_file
from pcretrieve.values import FloatArray

__all__ = ["write_conf", "write_pcd", "write_ply"]


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
