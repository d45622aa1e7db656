"""Points that are not of the body are removed, and nothing else is changed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import shapes
from benchmarks.simulation import RigOptions, scan as scanned
from scipy.spatial.transform import Rotation

from pcretrieve.errors import ReconstructionError
from pcretrieve.options import ScanOptions
from pcretrieve.points import crop
from pcretrieve.values import FloatArray, PointCloud

BODY = shapes.body(3)
POINTS = shapes.points_on(BODY, 6000)
DIAGONAL = BODY.diagonal
FLOOR = float(POINTS[:, 2].min())


def cropped(
    points: FloatArray, viewpoints: FloatArray | None = None, **options: Any
) -> PointCloud:
    return crop(PointCloud(points, viewpoints=viewpoints), ScanOptions(**options))


def notes(cloud: PointCloud) -> tuple[str, ...]:
    return cloud.provenance[-1].notes


def floor(n: int) -> FloatArray:
    """Noisy points on a disc beneath `BODY`, without its middle, which the body hides."""
    rng = np.random.default_rng(1)
    distance = DIAGONAL * np.sqrt(rng.uniform(0.05, 1, n))
    angle = rng.uniform(0, 2 * np.pi, n)
    height = FLOOR + 0.003 * DIAGONAL * rng.standard_normal(n)
    return np.column_stack([distance * np.cos(angle), distance * np.sin(angle), height])


@pytest.mark.parametrize("sensors", [True, False])
def test_a_scan_without_background_is_not_changed(sensors: bool) -> None:
    scan = scanned(BODY, RigOptions(), np.random.default_rng(0))
    scan = scan if sensors else PointCloud(scan.points)
    kept = crop(scan, ScanOptions())
    assert notes(kept) == ()
    np.testing.assert_array_equal(kept.points, scan.points)
    assert kept.provenance[-1].sizes == {
        "points_in": len(scan.points),
        "points": len(scan.points),
    }


@pytest.mark.parametrize(
    "stretch", [(1, 1, 0.02), (1, 0.05, 0.05), (1, 1, 1)], ids=["slab", "rod", "cube"]
)
def test_flat_sides_of_a_body_are_not_the_ground(stretch: FloatArray) -> None:
    """Also if only half of the body was seen, such as three sides of a cube."""
    rng = np.random.default_rng(0)
    side, at = rng.integers(6, size=20_000), rng.uniform(0, 1, (20_000, 3))
    at[np.arange(len(at)), side % 3] = side // 3
    box = (at + 0.002 * rng.standard_normal(at.shape)) * stretch
    box = Rotation.from_rotvec([0.3, 0.4, 0.5]).apply(box)
    for points in (box, box[side < 3], box[side != 0]):
        assert notes(cropped(points)) == ()


def test_a_base_is_a_part_of_the_body() -> None:
    """A disc around the feet that was seen from both sides, and has an edge, is not the ground."""
    disc = shapes.points_on(shapes.ellipsoid((DIAGONAL, DIAGONAL, 0.02 * DIAGONAL)), 6000)
    assert notes(cropped(np.concatenate([POINTS, disc + np.array([0, 0, FLOOR])]))) == ()


@pytest.mark.parametrize("share", [0.0005, 0.6])
def test_readings_at_the_largest_range_are_no_points(share: float) -> None:
    """A depth camera writes 65.535 m for a ray without an answer: as depth, or as range."""
    body = POINTS + np.array([0, 0, 4])
    n = max(2, round(share * len(body) / (1 - share)))
    at = np.column_stack(
        [np.random.default_rng(0).uniform(-0.4, 0.4, (n, 2)), np.ones(n)]
    )
    for rays in (at, at / np.linalg.norm(at, axis=1, keepdims=True)):
        kept = cropped(1000 * np.concatenate([body, 65.535 * rays]))
        np.testing.assert_array_equal(kept.points, 1000 * body)
        assert notes(kept) == (
            f"dropped {n} of {n + 6000} points at one range: readings without an answer",
        )


def test_ranges_and_box() -> None:
    z = POINTS[:, 2]
    low, high = POINTS.min(axis=0) - 1, POINTS.max(axis=0) + 1
    kept = cropped(POINTS, box=(tuple(low), (*high[:2], 0.5)))
    np.testing.assert_array_equal(kept.points, POINTS[z <= 0.5])
    assert notes(kept) == (f"dropped {(z > 0.5).sum()} of 6000 points outside the box",)

    sensor = np.array([0.0, 0.0, -5.0])
    range_ = np.linalg.norm(POINTS - sensor, axis=1)
    between = (range_ >= 4.5) & (range_ <= 5.5)
    kept = cropped(POINTS, sensor + 0 * POINTS, min_range=4.5, max_range=5.5)
    np.testing.assert_array_equal(kept.points, POINTS[between])
    # Without the position of the sensor, it is the origin.
    np.testing.assert_array_equal(
        cropped(POINTS - sensor, min_range=4.5, max_range=5.5).points,
        POINTS[between] - sensor,
    )
    with pytest.raises(
        ReconstructionError,
        match=r"left 0 \(dropped 6000 .* max_range = 0.1\): give a wider",
    ):
        cropped(POINTS + 100, max_range=0.1)


def test_one_point_far_away() -> None:
    for distance in (1e3, 3e38):  # the largest float32
        kept = cropped(np.concatenate([POINTS, [[distance, 0, 0]]]))
        np.testing.assert_array_equal(kept.points, POINTS)
        assert notes(kept) == (
            "dropped 1 of 6001 points more than 20 median distances from the middle",
        )


def test_a_twentieth_of_the_points_far_away_are_errors_and_more_may_be_a_body() -> None:
    far = POINTS + np.array([1e3, 0, 0])
    for share in (0.04, 0.06):
        n = round(share / (1 - share) * len(POINTS))
        kept = cropped(
            np.concatenate([POINTS, far[:n]]), keep_largest=False, ground="none"
        )
        assert len(kept.points) == len(POINTS) + (n if share > 0.05 else 0)


@pytest.mark.parametrize("n", [800, 20_000], ids=["few", "most"])
@pytest.mark.parametrize("turn", [(0, 0, 0), (1, 2, 3)], ids=["upright", "turned"])
def test_the_ground_goes_and_the_body_stays(n: int, turn: FloatArray) -> None:
    motion = Rotation.from_rotvec(turn)
    scan = motion.apply(np.concatenate([POINTS, floor(n)]))
    kept = cropped(scan)
    assert notes(kept)[0].endswith("points of the ground on which the body stands")
    sizes = kept.provenance[-1].sizes
    up = np.array([sizes[f"up_{axis}"] for axis in "xyz"])
    place = np.array([sizes[f"ground_{axis}"] for axis in "xyz"])
    assert up @ motion.apply([0, 0, 1]) > 0.9999
    assert motion.inv().apply(place)[2] == pytest.approx(FLOOR, abs=0.003 * DIAGONAL)
    assert np.linalg.norm(motion.inv().apply(place)[:2]) < 0.2 * DIAGONAL
    heights = (kept.points - place) @ up
    assert heights.min() > 0
    # What is left of the ground, and what was taken of the body.
    is_body = np.isin(kept.points, motion.apply(POINTS)).all(axis=1)
    assert (~is_body).sum() < 0.02 * n
    assert is_body.sum() > 0.97 * len(POINTS)
