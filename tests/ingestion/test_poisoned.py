"""Numbers that no scanner measured: each scan has a signature or a clear error, and none harms another.

The files are PLY with wrong bytes, garbage, absurd units and places.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapes
from numpy.typing import NDArray

from pcretrieve import Catalogue, PipelineOptions, ingest, reconstruct, signature
from pcretrieve.errors import ReconstructionError
from pcretrieve.gallery.fitted import signatures
from pcretrieve.values import FloatArray

POINTS = shapes.points_on(shapes.body(), 6000)


def ply_of(body: bytes, n_vertices: int, kind: str) -> bytes:
    """A binary little-endian PLY file whose header declares coordinates of type `kind`."""
    coordinates = "".join(f"property {kind} {axis}\n" for axis in "xyz")
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {n_vertices}\n{coordinates}end_header\n"
    return header.encode() + body


def floats(points: FloatArray, kind: str = "<f4") -> bytes:
    return ply_of(points.astype(kind).tobytes(), len(points), "float")


def doubles(points: FloatArray, kind: str = "<f8") -> bytes:
    return ply_of(points.astype(kind).tobytes(), len(points), "double")


def with_garbage(points: FloatArray, share: float, kind: str) -> NDArray[np.generic]:
    """The points as numbers of one type, a share of them random bytes."""
    rng = np.random.default_rng(0)
    numbers = points.astype(kind)
    hit = rng.random(len(points)) < share
    numbers[hit] = np.frombuffer(
        rng.bytes(int(hit.sum()) * 3 * numbers.itemsize), kind
    ).reshape(-1, 3)
    return numbers


def far_and_near(share: float) -> FloatArray:
    """The points, a share of them spread over a cube of side 2e49."""
    rng = np.random.default_rng(0)
    return np.where(
        rng.random((len(POINTS), 1)) < share,
        rng.uniform(-1e49, 1e49, POINTS.shape),
        POINTS,
    )


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
    "byte_swapped": floats(POINTS, ">f4"),
    "doubles_byte_swapped": doubles(POINTS, ">f8"),
    "one_byte_late": ply_of(
        (b"\0" + POINTS.astype("<f4").tobytes())[:-1], len(POINTS), "float"
    ),
    "doubles_read_as_floats": ply_of(
        POINTS.astype("<f8").tobytes(), 2 * len(POINTS), "float"
    ),
    "floats_read_as_doubles": ply_of(
        POINTS.astype("<f4").tobytes(), len(POINTS) // 2, "double"
    ),
    "garbage_of_floats": ply_of(
        with_garbage(POINTS, 0.3, "<f4").tobytes(), len(POINTS), "float"
    ),
    "garbage_of_doubles": ply_of(
        with_garbage(POINTS, 0.3, "<f8").tobytes(), len(POINTS), "double"
    ),
    "only_garbage": ply_of(
        with_garbage(POINTS, 1, "<f4").tobytes(), len(POINTS), "float"
    ),
    "far_and_near": doubles(far_and_near(0.3)),
    "lost_in_the_distance": doubles(POINTS + 1e16),
    "sensors_of_garbage": ply_of(
        np.column_stack([POINTS, with_garbage(POINTS, 1, "<f8").astype(float)])
        .astype("<f8")
        .tobytes(),
        len(POINTS),
        "double",
    ).replace(
        b"z\n",
        b"z\nproperty double vp_x\nproperty double vp_y\nproperty double vp_z\n",
        1,
    ),
}


@pytest.mark.slow
def test_a_batch_stores_every_good_scan_beside_poisoned_ones(tmp_path: Path) -> None:
    """No native code may crash, no fault may be left unexplained, and the batch may not end early."""
    # The good scans come first and last; two files of one content would be stored once.
    good = {"a_good": doubles(POINTS), "z_good": doubles(POINTS[::-1])} | SAME_BODY
    for name, content in (good | GARBAGE).items():
        (tmp_path / f"{name}.ply").write_bytes(content)
    with Catalogue(tmp_path / "c.sqlite", create=True) as catalogue:
        summary = ingest(tmp_path / "*.ply", catalogue)
        table = signatures(
            catalogue, options=catalogue.options.changed(signature={"method": "r-bihdm"})
        )
    done, failed = (
        {record.id for record in records} for records in (summary.done, summary.failed)
    )
    assert done | failed == {*good, *GARBAGE}
    assert failed <= {*GARBAGE}
    kinds = {record.error for record in summary.failed}
    assert kinds <= {"ScanReadError", "ReconstructionError", "DegenerateMeshError"}, (
        summary.failed
    )
    expected = np.log(signature(POINTS, {"signature": {"method": "r-bihdm"}}).values)
    for name in good:
        found = np.log(table.values[table.ids.index(name)])
        np.testing.assert_allclose(found, expected, atol=0.02, err_msg=name)


def test_points_that_single_precision_merges_are_refused() -> None:
    """A tenth of the points so far away that all others coincide, and no thinning that drops them first."""
    options = PipelineOptions().changed(scan={"voxel": 0.0})
    with pytest.raises(
        ReconstructionError,
        match="at least 100 points must be distinct in single precision",
    ):
        reconstruct(far_and_near(0.1), options)
