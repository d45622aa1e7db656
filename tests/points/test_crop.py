"""Points that are not of the body are removed, and nothing else is changed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import shapes
from scipy.spatial.transform import Rotation

from pcretrieve import process
from pcretrieve.errors import ReconstructionError
from pcretrieve.options import ScanOptions
from pcretrieve.points import crop
from pcretrieve.simulation import UniformOptions, scan_uniformly
from pcretrieve.values import FloatArray, PointCloud

BODY = shapes.body(3)
POINTS = shapes.points_on(BODY, 6000)
DIAGONAL = BODY.diagonal
FLOOR = float(POINTS[:, 2].min())


def cropped(points: FloatArray, viewpoints: FloatArray | None = None, **options: Any) -> PointCloud:
    return crop(PointCloud(points, viewpoints=viewpoints), ScanOptions(**options))


def notes(cloud: PointCloud) -> tuple[str, ...]:
    return cloud.provenance[-1].notes


def floor(n: int = 3000, *, noise: float = 0.0, radius: float = 1.0) -> FloatArray:
    """Points on a disc beneath `BODY`, without its middle, which the body hides; radius in diagonals."""
    rng = np.random.default_rng(1)
    distance = radius * DIAGONAL * np.sqrt(rng.uniform(0.05, 1, n))
    angle = rng.uniform(0, 2 * np.pi, n)
    height = FLOOR + noise * DIAGONAL * rng.standard_normal(n)
    return np.column_stack([distance * np.cos(angle), distance * np.sin(angle), height])


# --- nothing to remove --------------------------------------------------------------------------------


@pytest.mark.parametrize("sensors", [True, False])
def test_a_scan_without_background_is_not_changed(sensors: bool) -> None:
    scan = scan_uniformly(BODY, UniformOptions(), np.random.default_rng(0))
    scan = scan if sensors else PointCloud(scan.points)
    kept = crop(scan, ScanOptions())
    assert notes(kept) == ()
    np.testing.assert_array_equal(kept.points, scan.points)
    assert kept.provenance[-1].sizes == {"points_in": len(scan.points), "points": len(scan.points)}


@pytest.mark.parametrize("stretch", [(1, 1, 0.02), (1, 0.05, 0.05), (1, 1, 1)], ids=["slab", "rod", "cube"])
@pytest.mark.parametrize("noise", [0.0, 0.002])
def test_flat_sides_of_a_body_are_not_the_ground(stretch: FloatArray, noise: float) -> None:
    """Also if only half of the body was seen, such as three sides of a cube."""
    rng = np.random.default_rng(0)
    side, at = rng.integers(6, size=20_000), rng.uniform(0, 1, (20_000, 3))
    at[np.arange(len(at)), side % 3] = side // 3
    box = (at + noise * rng.standard_normal(at.shape)) * stretch
    box = Rotation.from_rotvec([0.3, 0.4, 0.5]).apply(box)
    for points in (box, box[side < 3], box[side != 0]):
        assert notes(cropped(points)) == ()


def test_a_base_is_a_part_of_the_body() -> None:
    """A disc around the feet that was seen from both sides, and has an edge, is not the ground."""
    disc = shapes.points_on(shapes.ellipsoid((DIAGONAL, DIAGONAL, 0.02 * DIAGONAL)), 6000)
    assert notes(cropped(np.concatenate([POINTS, disc + np.array([0, 0, FLOOR])]))) == ()


# --- readings -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.0005, 0.1, 0.6])
@pytest.mark.parametrize("unit", [1.0, 1000.0])
def test_readings_at_the_largest_range_are_no_points(share: float, unit: float) -> None:
    """A depth camera writes 65.535 m for a ray without an answer: as depth, or as range."""
    body = POINTS + np.array([0, 0, 4])
    n = max(2, round(share * len(body) / (1 - share)))
    at = np.column_stack([np.random.default_rng(0).uniform(-0.4, 0.4, (n, 2)), np.ones(n)])
    for rays in (at, at / np.linalg.norm(at, axis=1, keepdims=True)):
        kept = cropped(unit * np.concatenate([body, 65.535 * rays]))
        np.testing.assert_array_equal(kept.points, unit * body)
        assert notes(kept) == (f"dropped {n} of {n + 6000} points at one range: readings without an answer",)


def test_readings_at_the_sensor_are_no_points() -> None:
    sensor = np.array([0.0, 0.0, -4.0])
    scan = np.concatenate([POINTS, np.tile(sensor, (900, 1))])
    kept = cropped(scan, np.tile(sensor, (len(scan), 1)))
    np.testing.assert_array_equal(kept.points, POINTS)
    assert kept.viewpoints is not None and len(kept.viewpoints) == 6000


def test_points_at_one_distance_that_others_reach_are_of_the_body() -> None:
    ball = shapes.points_on(shapes.icosphere(4), 5000)
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    assert notes(cropped(ball)) == notes(cropped(np.concatenate([ball, 0.8 * ball]))) == ()


# --- options ------------------------------------------------------------------------------------------


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
        cropped(POINTS - sensor, min_range=4.5, max_range=5.5).points, POINTS[between] - sensor
    )


def test_a_crop_that_leaves_no_body_says_by_which_rule() -> None:
    with pytest.raises(
        ReconstructionError, match=r"left 0 \(dropped 6000 .* max_range = 0.1\): give a wider"
    ):
        cropped(POINTS + 100, max_range=0.1)


def test_the_largest_piece() -> None:
    lamp = 0.1 * POINTS[::4] + np.array([0, 0, DIAGONAL])
    both = np.concatenate([lamp, POINTS])
    assert notes(cropped(both)) == ()
    np.testing.assert_array_equal(cropped(both, keep_largest=True, piece_gap=0.05).points, POINTS)
    assert len(cropped(both, keep_largest=True, piece_gap=0.5).points) == len(both)


# --- far points and strays ----------------------------------------------------------------------------


@pytest.mark.parametrize("distance", [1e3, 1e10, 3e38], ids=["far", "very far", "largest float32"])
def test_one_point_far_away(distance: float) -> None:
    kept = cropped(np.concatenate([POINTS, [[distance, 0, 0]]]))
    np.testing.assert_array_equal(kept.points, POINTS)
    assert notes(kept) == ("dropped 1 of 6001 points more than 20 median distances from the middle",)


def test_a_second_body_is_not_taken_for_errors() -> None:
    both = np.concatenate([POINTS, POINTS[::10] + 100 * DIAGONAL])
    assert notes(cropped(both)) == ()


def test_strays_do_not_stretch_the_diagonal() -> None:
    """A wall of .17 % of the points, at a distance of some diagonals: 2.6 times the diagonal of the body."""
    wall = np.random.default_rng(0).uniform(-0.1, 0.1, (10, 3)) + np.array([0, 0, 2 * DIAGONAL])
    scan = PointCloud(np.concatenate([POINTS, wall]))
    assert scan.diagonal > 2 * DIAGONAL
    kept = crop(scan, ScanOptions())
    np.testing.assert_array_equal(kept.points, POINTS)
    stray, lengths = notes(kept)
    assert stray == "dropped 10 of 6010 points as strays outside the box of their quantiles"
    assert lengths == (
        f"lengths are relative to a diagonal of {kept.diagonal:.4g}, with the strays {scan.diagonal:.4g}"
    )


# --- ground -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("noise", [0.0, 0.001, 0.003])
@pytest.mark.parametrize("n", [800, 3000, 20_000], ids=["few", "some", "most"])
@pytest.mark.parametrize("turn", [(0, 0, 0), (1, 2, 3)], ids=["upright", "turned"])
def test_the_ground_goes_and_the_body_stays(noise: float, n: int, turn: FloatArray) -> None:
    motion = Rotation.from_rotvec(turn)
    scan = motion.apply(np.concatenate([POINTS, floor(n, noise=noise)]))
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


def test_the_ground_can_be_kept() -> None:
    scan = np.concatenate([POINTS, floor()])
    assert notes(cropped(scan, ground="none")) == ()


def test_a_plane_between_body_and_sensor_is_not_the_ground() -> None:
    scan = np.concatenate([POINTS, floor()])
    above, below = np.array([0, 0, 10 * DIAGONAL]), np.array([0, 0, -10 * DIAGONAL])
    assert notes(cropped(scan, above + 0 * scan)) != ()
    assert notes(cropped(scan, below + 0 * scan)) == ()


def test_a_wall_behind_a_body_is_not_the_ground() -> None:
    assert notes(cropped(np.concatenate([POINTS, floor() - np.array([0, 0, 0.5 * DIAGONAL])]))) == ()


def test_background_does_not_change_the_surface() -> None:
    """Beyond what the soles change: the whole chain, with and without the ground."""
    options = {"surface": {"cell": 0.01, "target_faces": 3000}}
    alone = process(PointCloud(POINTS, viewpoints=5 * POINTS), options)
    scan = np.concatenate([POINTS, floor()])
    seen = np.concatenate([5 * POINTS, np.tile([0.0, 0.0, 5.0], (3000, 1))])
    with_floor = process(PointCloud(scan, viewpoints=seen), options)
    assert with_floor.mesh.area == pytest.approx(alone.mesh.area, rel=0.01)
