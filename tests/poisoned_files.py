"""PLY files whose numbers are not what a scanner measured: wrong bytes, garbage, absurd units and places."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import shapes
from numpy.typing import NDArray

from pcretrieve.values import FloatArray

POINTS = shapes.points_on(shapes.body(), 6000)


def ply_of(body: bytes, n_vertices: int, kind: str) -> bytes:
    """A binary little-endian PLY file whose header declares coordinates of type `kind`."""
    coordinates = "".join(f"property {kind} {axis}\n" for axis in "xyz")
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {n_vertices}\n{coordinates}end_header\n"
    return header.encode() + body


def floats(points: FloatArray) -> bytes:
    return ply_of(points.astype("<f4").tobytes(), len(points), "float")


def doubles(points: FloatArray) -> bytes:
    return ply_of(points.astype("<f8").tobytes(), len(points), "double")


def with_garbage(points: FloatArray, share: float, kind: str) -> NDArray[np.generic]:
    """The points as numbers of one type, a share of them random bytes."""
    rng = np.random.default_rng(0)
    numbers = points.astype(kind)
    hit = rng.random(len(points)) < share
    numbers[hit] = np.frombuffer(rng.bytes(int(hit.sum()) * 3 * numbers.itemsize), kind).reshape(-1, 3)
    return numbers


def far_and_near(share: float) -> FloatArray:
    """The points, a share of them spread over a cube of side 2e49."""
    rng = np.random.default_rng(0)
    return np.where(rng.random((len(POINTS), 1)) < share, rng.uniform(-1e49, 1e49, POINTS.shape), POINTS)


# The same body, in a unit or at a place that single precision cannot bear.
SAME_BODY = {
    "huge": floats(POINTS * 1e38),
    "squares_overflow": floats(POINTS * 1e20),
    "tiny": doubles(POINTS * 1e-49),
    "squares_vanish": floats(POINTS * 1e-30),
    "far_away": doubles(100 * POINTS + 1e14),
}

# Files that must not end the process that reads them, whatever the result.
GARBAGE = {
    "byte_swapped": ply_of(POINTS.astype(">f4").tobytes(), len(POINTS), "float"),
    "doubles_byte_swapped": ply_of(POINTS.astype(">f8").tobytes(), len(POINTS), "double"),
    "one_byte_late": ply_of((b"\0" + POINTS.astype("<f4").tobytes())[:-1], len(POINTS), "float"),
    "one_byte_early": ply_of(POINTS.astype("<f4").tobytes()[1:] + b"\0", len(POINTS), "float"),
    "doubles_read_as_floats": ply_of(POINTS.astype("<f8").tobytes(), 2 * len(POINTS), "float"),
    "floats_read_as_doubles": ply_of(POINTS.astype("<f4").tobytes(), len(POINTS) // 2, "double"),
    "garbage_of_floats": ply_of(with_garbage(POINTS, 0.3, "<f4").tobytes(), len(POINTS), "float"),
    "garbage_of_doubles": ply_of(with_garbage(POINTS, 0.3, "<f8").tobytes(), len(POINTS), "double"),
    "only_garbage": ply_of(with_garbage(POINTS, 1, "<f4").tobytes(), len(POINTS), "float"),
    "far_and_near": doubles(far_and_near(0.3)),
    "lost_in_the_distance": doubles(POINTS + 1e16),
    "sensors_of_garbage": ply_of(
        np.column_stack([POINTS, with_garbage(POINTS, 1, "<f8").astype(float)]).astype("<f8").tobytes(),
        len(POINTS),
        "double",
    ).replace(b"z\n", b"z\nproperty double vp_x\nproperty double vp_y\nproperty double vp_z\n", 1),
}


def write(folder: Path, files: dict[str, bytes]) -> None:
    """One ``.ply`` file for each."""
    for name, content in files.items():
        (folder / f"{name}.ply").write_bytes(content)
