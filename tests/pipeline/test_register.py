"""Registration of views with unknown poses: views of one body are registered, others are left out."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapes
from benchmarks.simulation import RigOptions, scan_views
from scipy.spatial.transform import Rotation

from pcretrieve import PointCloud
from pcretrieve.errors import InputError, OptionError, ReconstructionError
from pcretrieve.ingestion.views import read_views
from pcretrieve.options import MergeOptions, ScanOptions
from pcretrieve.pipeline.registration import merge_views
from pcretrieve.pipeline.registration.alignment import moved
from pcretrieve.pipeline.registration.views import RangeImage
from pcretrieve.values import FloatArray

FAR = ScanOptions()
RIG = RigOptions(n_views=6, pixels=120, n_points=None)

# Largest distance of any point from its true place, relative to the diagonal of the body; half the distance
# within which surfaces count as one.
TOLERANCE = 0.005


def motion(
    rng: np.random.Generator, *, angle: float | None = None, shift: float = 3.0
) -> FloatArray:
    """(4, 4) random rigid motion, with any rotation, or one by `angle` about a random axis."""
    turn = Rotation.random(rng=rng)
    if angle is not None:
        turn = Rotation.from_rotvec(angle * turn.apply([1.0, 0, 0]))
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = turn.as_matrix(), rng.normal(0, shift, 3)
    return result


@cache
def views() -> tuple[tuple[PointCloud, ...], FloatArray]:
    """Six noisy views of a body, each in a frame of its own, and the motions into these frames."""
    rng = np.random.default_rng(0)
    return apart(scan_views(shapes.body(), RIG, rng), rng)


def apart(
    seen: list[PointCloud], rng: np.random.Generator
) -> tuple[tuple[PointCloud, ...], FloatArray]:
    motions = np.array([motion(rng) for _ in seen])
    clouds = []
    for view, away in zip(seen, motions, strict=True):
        assert view.viewpoints is not None
        clouds.append(
            PointCloud(moved(away, view.points), viewpoints=moved(away, view.viewpoints))
        )
    return tuple(clouds), motions


def error(poses: FloatArray, truth: FloatArray, clouds: Sequence[PointCloud]) -> float:
    """Largest distance of any point from its place; diagonals of the body."""
    off = [
        np.linalg.norm(
            moved(pose, cloud.points) - moved(true, cloud.points), axis=1
        ).max()
        for pose, true, cloud in zip(poses, truth, clouds, strict=True)
    ]
    return float(max(off)) / shapes.body().diagonal


@pytest.mark.slow
@pytest.mark.parametrize("step", [1, -1], ids=["forwards", "backwards"])
def test_views_come_back_from_anywhere(step: int) -> None:
    clouds, motions = views()[0][::step], views()[1][::step]
    merged = merge_views(clouds, MergeOptions(), FAR)
    assert merged.left_out == ()
    np.testing.assert_allclose(merged.poses[0], np.eye(4), atol=1e-12)
    assert error(merged.poses, motions[0] @ np.linalg.inv(motions), clouds) < TOLERANCE
    assert merged.shares.min() > 0.7
    # Noise of a thousandth of the diagonal on either side, more where surfaces are slanted.
    assert merged.rms() < 0.003 * shapes.body().diagonal


def test_a_foreign_view_is_left_out_and_said_so() -> None:
    clouds, motions = views()[0][2:4], views()[1][2:4]
    rng = np.random.default_rng(1)
    foreign, _ = apart(scan_views(shapes.torus(major=2.0), RIG, rng)[:1], rng)
    found = merge_views([*clouds, *foreign], MergeOptions(), FAR)
    assert found.left_out == (2,)
    assert error(found.poses[:2], motions[0] @ np.linalg.inv(motions), clouds) < TOLERANCE
    assert np.isnan(found.poses[2]).all() and found.shares[2] == 0
    assert not any(2 in (pair.first, pair.second) for pair in found.overlaps)
    (step,) = found.cloud.provenance
    assert any("left out view 2" in note for note in step.notes)
    assert len(found.cloud.points) == sum(len(view.points) for view in clouds)


def test_given_poses_are_refined_or_kept() -> None:
    clouds, motions = views()
    rng = np.random.default_rng(2)
    diagonal = shapes.body().diagonal
    truth = np.linalg.inv(motions)
    rough = np.array(
        [motion(rng, angle=np.radians(2), shift=0.01 * diagonal) @ pose for pose in truth]
    )
    kept = merge_views(clouds, MergeOptions(refine=False), FAR, poses=rough)
    np.testing.assert_array_equal(kept.poses, rough)
    refined = merge_views(clouds, MergeOptions(), FAR, poses=rough)
    np.testing.assert_array_equal(refined.poses[0], rough[0])
    assert refined.rms() < 0.7 * kept.rms()
    # To where the first view, which stays, was put.
    back = rough[0] @ np.linalg.inv(truth[0])
    assert error(refined.poses, back @ truth, clouds) < TOLERANCE


def test_readings_at_the_sensor_are_no_points() -> None:
    """Nor those at the origin of a view that does not say where its sensor is."""
    rng = np.random.default_rng(4)
    clouds, motions = views()
    poses = np.linalg.inv(motions).astype(np.float64)
    n_clean = sum(len(cloud.points) for cloud in clouds)
    dirty = []
    for cloud in clouds:
        assert cloud.viewpoints is not None
        place = np.tile(cloud.viewpoints[0], (len(cloud.points), 1))
        rounded = place * (1 + rng.normal(0, 1e-15, place.shape))
        points = np.concatenate([cloud.points, rounded])
        dirty.append(PointCloud(points, viewpoints=np.concatenate([place, place])))
    found = merge_views(dirty, MergeOptions(refine=False), FAR, poses=poses)
    assert len(found.cloud.points) <= n_clean
    blind = [
        PointCloud(np.concatenate([cloud.points, np.zeros((9, 3))])) for cloud in clouds
    ]
    found = merge_views(blind, MergeOptions(refine=False), FAR, poses=poses)
    assert len(found.cloud.points) == n_clean


@pytest.mark.parametrize("wrong", [(), (3,), (1, 4)])
def test_views_that_stand_off_the_others_are_named(wrong: tuple[int, ...]) -> None:
    """Moved by 12 mm and turned by 1.5 degrees, if the body is a person; the views beside them are right."""
    clouds, motions = views()
    rng = np.random.default_rng(5)
    poses = np.linalg.inv(motions).astype(np.float64)
    for number in wrong:
        shift = motion(rng, angle=np.radians(1.5), shift=0.0)
        shift[:3, 3] = (
            0.0067 * shapes.body().diagonal * Rotation.random(rng=rng).apply([1.0, 0, 0])
        )
        poses[number] = shift @ poses[number]
    found = merge_views(clouds, MergeOptions(refine=False), FAR, poses=poses)
    (step,) = found.cloud.provenance
    named = {int(note.split()[1]) for note in step.notes if "stands" in note}
    assert named == {*wrong}
    refined = merge_views(clouds, MergeOptions(), FAR, poses=poses)
    assert not any("stands" in note for note in refined.cloud.provenance[0].notes)


def test_background_is_dropped_before_views_are_matched() -> None:
    """A wall behind the body is removed by its distance, a lamp beside it as a smaller component."""
    clouds, motions = views()
    rng = np.random.default_rng(3)
    poses = np.linalg.inv(motions).astype(np.float64)
    diagonal = shapes.body().diagonal
    distance = RIG.distance * diagonal
    dirty = []
    for cloud, away in zip(clouds, motions, strict=True):
        assert cloud.viewpoints is not None
        sensor = cloud.viewpoints[0]
        ahead = (moved(away, np.zeros((1, 3)))[0] - sensor) / distance
        wall = sensor + 3 * distance * ahead + rng.normal(0, 0.2 * diagonal, (500, 3))
        lamp = rng.normal(cloud.points.mean(axis=0) + diagonal, 0.01 * diagonal, (50, 3))
        dirty.append(
            PointCloud(np.concatenate([wall, cloud.points, lamp]), viewpoints=sensor)
        )
    options, near = (
        MergeOptions(keep_largest=True, refine=False),
        ScanOptions(max_range=1.7 * distance),
    )
    found = merge_views(dirty, options, near, poses=poses)
    n_clean = sum(len(cloud.points) for cloud in clouds)
    # Outliers of the simulated cameras are components too.
    assert 0.98 * n_clean < len(found.cloud.points) <= n_clean
    assert (
        np.linalg.norm(
            found.cloud.points - shapes.body().vertices.mean(axis=0), axis=1
        ).max()
        < diagonal
    )
    left = merge_views(dirty, MergeOptions(refine=False), FAR, poses=poses)
    assert len(left.cloud.points) == n_clean + 6 * 550


CLOUD = PointCloud(shapes.points_on(shapes.icosphere(3), 500))
MOVING = PointCloud(CLOUD.points, viewpoints=2 * CLOUD.points)
FRONT = CLOUD.select(CLOUD.points[:, 2] > 0.3)
FLAT = PointCloud(4 * shapes.points_on(shapes.square(1), 500))
STILL = np.tile(np.eye(4), (2, 1, 1))
CLOSE: dict[str, Any] = {"max_range": 0.1, "sensor": "origin"}


@pytest.mark.parametrize(
    ("clouds", "options", "poses", "raised", "words"),
    [
        ([CLOUD], {}, None, InputError, "at least two views, got 1"),
        (
            [CLOUD] * 2,
            {},
            STILL[:1],
            InputError,
            r"shape \(2, 4, 4\), one for each view, got \(1, 4, 4\)",
        ),
        ([CLOUD] * 2, {}, 2 * STILL, InputError, "rigid motions"),
        ([CLOUD] * 2, {}, STILL * [[-1], [1], [1], [1]], InputError, "rigid motions"),
        ([CLOUD] * 2, {"max_range": 0.0}, None, OptionError, "max_range"),
        (
            [CLOUD] * 2,
            {"max_range": 3.0},
            None,
            InputError,
            "view 0 does not say where that is",
        ),
        ([CLOUD, MOVING], {}, None, InputError, "view 1 was seen by several"),
        (
            [CLOUD, PointCloud(CLOUD.points[:9])],
            {},
            None,
            ReconstructionError,
            "1 must have more than 16",
        ),
        (
            [CLOUD, PointCloud(np.ones((500, 3)))],
            {},
            None,
            ReconstructionError,
            "1 must have more than 16",
        ),
        (
            [CLOUD, PointCloud(np.empty((0, 3)))],
            {},
            None,
            ReconstructionError,
            "view 1 has no points",
        ),
        (
            [FRONT, FLAT],
            {},
            None,
            ReconstructionError,
            "no two of the 2 views share a surface",
        ),
        (
            [CLOUD] * 2,
            CLOSE,
            None,
            ReconstructionError,
            "view 0 .* 16 different points in reach, got 0",
        ),
    ],
)
def test_what_cannot_be_merged_says_why(
    clouds: list[PointCloud],
    options: dict[str, Any],
    poses: FloatArray | None,
    raised: type,
    words: str,
) -> None:
    with pytest.raises(raised, match=words):
        near = ScanOptions(max_range=options.get("max_range", "none"))
        merge = {name: value for name, value in options.items() if name != "max_range"}
        merge_views(clouds, MergeOptions(**merge), near, poses=poses)


def test_a_range_image_of_a_square_seen_from_above() -> None:
    ticks = np.linspace(-0.5, 0.5, 41)
    points = np.stack([*np.meshgrid(ticks, ticks), np.zeros((41, 41))], axis=-1).reshape(
        -1, 3
    )
    up, down = np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 0.0, -1.0]])
    image = RangeImage(
        points, np.broadcast_to(up, points.shape), np.array([0.0, 0.0, 5.0])
    )
    for point, normal, agrees, contradicts in (
        ((0.1, 0.2, 0.0), up, True, False),
        ((0.1, 0.2, 0.09), up, True, False),
        ((0.1, 0.2, 0.0), down, False, False),  # the back of a sheet is not its front
        ((0.1, 0.2, 0.3), up, False, True),
        ((0.1, 0.2, 0.3), down, False, True),
        ((0.1, 0.2, -0.3), up, False, False),  # hidden
        ((0.9, 0.0, 0.3), up, False, False),  # beside the square: not observed
        ((0.1, 0.2, 9.0), up, False, False),  # behind the sensor
    ):
        said = image.compare(np.array([point]), normal, tolerance=0.1)
        assert (said.agrees.tolist(), said.contradicts.tolist()) == (
            [agrees],
            [contradicts],
        ), point


# --- real scans ---------------------------------------------------------------------------------------

DATA = Path(__file__).parents[3] / "shared" / "data"


@pytest.mark.skipif(
    not DATA.is_dir(), reason="needs the Stanford scans, in ../shared/data"
)
@pytest.mark.slow
def test_the_views_of_the_bunny_are_registered() -> None:
    """Ten scans without poses; where two of them are one surface, they are so to a third of a millimetre."""
    clouds = read_views([DATA / "stanford_bunny"]).clouds
    found = merge_views(clouds, MergeOptions(), FAR)
    assert len(clouds) == 10 and found.left_out == ()
    assert found.rms() < 4e-4
    assert found.shares.min() > 0.7
    # The turntable: scans 000, 090, 180 and 270 look along four sides.
    looking = found.poses[[0, 2, 3, 4], :3, 2]  # (4, 3)
    opposite = np.roll(np.eye(4), 2, axis=1)
    np.testing.assert_allclose(looking @ looking.T, np.eye(4) - opposite, atol=0.02)
