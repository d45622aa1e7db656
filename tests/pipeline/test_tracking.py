"""Frames of a depth camera before a turning body: registered in their order, or from the poses in files.

The files are as the tools of the TUM RGB-D benchmark write them.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import shapes
from benchmarks.turning import TurningOptions, turning_frames, write_frames
from PIL import Image
from scipy.spatial.transform import Rotation

import pcretrieve
from pcretrieve import PointCloud, TriangleMesh
from pcretrieve.arrays.open3d import RayScene
from pcretrieve.errors import ScanReadError
from pcretrieve.ingestion.views import image_poses, trajectory_file
from pcretrieve.options import MergeOptions, PipelineOptions, ScanOptions
from pcretrieve.pipeline.registration import merge_views
from pcretrieve.pipeline.registration.alignment import moved
from pcretrieve.pipeline.registration.views import depth_limit, placed_by, prepared
from pcretrieve.values import FloatArray

CAMERA = TurningOptions(n_frames=30, width=120, height=160, focal=170.0)
DEPTH_CAMERA = PipelineOptions.of("depth-camera").merge


@cache
def body() -> TriangleMesh:
    """A body of the height of a person; m."""
    mesh = shapes.body()
    return replace(mesh, vertices=1.7 * mesh.vertices / np.ptp(mesh.vertices[:, 1]))


@cache
def sequence() -> tuple[FloatArray, FloatArray]:
    return turning_frames(body(), CAMERA, np.random.default_rng(0))


def error(poses: FloatArray, truth: FloatArray, points: FloatArray) -> float:
    """Largest distance of a point from its place; m."""
    return float(
        np.linalg.norm(moved(poses, points) - moved(truth, points), axis=2).max()
    )


@pytest.mark.slow
def test_a_turn_before_a_camera_becomes_one_cloud_without_its_background(
    tmp_path: Path,
) -> None:
    images, motions = sequence()
    write_frames(tmp_path, images, CAMERA)
    merged = pcretrieve.merge_views(tmp_path, "depth-camera")
    assert merged.left_out == ()
    (step,) = merged.cloud.provenance
    took, note = step.notes
    assert took.startswith("took max_range = ")
    n_keys = int(note.split()[-3])
    assert (
        note == f"registered 30 views of a sequence by {n_keys} key frames"
        and 5 < n_keys < 30
    )
    assert (
        error(merged.poses @ motions, motions[:1], body().vertices[::50])
        < 0.01 * body().diagonal
    )
    assert merged.rms() < 0.003 * merged.scale
    surface = RayScene(moved(motions[0], body().vertices), body().faces)
    # The floor reaches the soles, and noise is not bounded.
    assert (
        np.quantile(surface.distance(merged.cloud.points), 0.999) < 0.02 * body().diagonal
    )


def test_a_foreign_frame_does_not_end_the_sequence(tmp_path: Path) -> None:
    images, _ = sequence()
    strange, _ = turning_frames(shapes.torus(major=0.6), CAMERA, np.random.default_rng(1))
    write_frames(tmp_path, np.stack([*images[:2], strange[0], images[3]]), CAMERA)
    found = pcretrieve.merge_views(tmp_path, "depth-camera")
    assert found.left_out == (2,)
    (step,) = found.cloud.provenance
    assert any("left out view 2" in note for note in step.notes)


# --- the background ------------------------------------------------------------------------------------


@cache
def in_a_room(n_frames: int) -> list[PointCloud]:
    """Frames of a turn on a floor, before a room of which nothing is flat."""
    camera = replace(CAMERA, n_frames=n_frames, wall=2.9)
    images, _ = turning_frames(body(), camera, np.random.default_rng(0))
    height, width = images.shape[1:]
    things = np.random.default_rng(2).normal(3.1, 0.12, (height // 8, width // 8))
    images = np.where(images > 2.75, np.kron(things, np.ones((8, 8))), images)
    v, u = np.indices((height, width))
    rays = np.stack(
        [u - (width - 1) / 2, v - (height - 1) / 2, np.full(u.shape, camera.focal)]
    )
    clouds = []
    for image in images:
        points = (rays / camera.focal * image)[:, image > 0].T
        clouds.append(PointCloud(points))
    return clouds


def farthest(background: str) -> list[float]:
    """The largest range in each view without its background."""
    options = DEPTH_CAMERA.model_copy(update={"background": background})
    views, _, _ = prepared(in_a_room(4), options, ScanOptions(), np.random.default_rng(0))
    return [float(np.linalg.norm(view.cloud.points, axis=1).max()) for view in views]


def test_a_room_ends_at_a_valley_of_the_histogram_of_depths() -> None:
    """In which the floor is; planes alone leave the largest piece of the room."""
    assert max(farthest("room")) < 2.8 < min(farthest("planes"))
    view = in_a_room(4)[0]
    assert (
        depth_limit(view, MergeOptions(sensor="front")) is None
    )  # nobody knows where the sensor is
    ball = np.add(shapes.icosphere(4).vertices, [0, 0, 3])
    assert depth_limit(PointCloud(ball), DEPTH_CAMERA) is None


def test_a_view_without_a_place_says_what_would_place_it() -> None:
    view = in_a_room(4)[0]
    for options, words in (
        (
            MergeOptions(sensor="origin"),
            "it has a background, remove that by --max-range 2",
        ),
        (MergeOptions(), "if it is of a depth camera, give --sensor origin"),
        (MergeOptions(sensor="origin", background="room"), "give --keep-largest"),
        (DEPTH_CAMERA, "lower min_overlap in [merge]"),
    ):
        assert words in placed_by(view, options, ScanOptions())


@pytest.mark.slow
def test_frames_far_apart_in_a_room_are_placed_by_the_preset() -> None:
    """Every tenth of a hundred."""
    preset = PipelineOptions.of("depth-camera")
    assert merge_views(in_a_room(10), preset.merge, preset.scan).left_out == ()


# --- poses in files -----------------------------------------------------------------------------------

# The camera that TUM recommends as a default, and its unit of depth; 1/m.
TUM_CAMERA = TurningOptions(n_frames=3, turn=90, width=640, height=480, focal=525.0)
TUM_SCALE = 5000

START = 1305031102.1604
HEADER = "# {}\n# file: 'rgbd_dataset_freiburg1_xyz.bag'\n# timestamp {}\n"


def pose_line(time: float, pose: FloatArray) -> str:
    """A line of groundtruth.txt, with four digits, and more of the pose."""
    quaternion = Rotation.from_matrix(pose[:3, :3]).as_quat()
    return (
        " ".join(
            [f"{time:.4f}", *(f"{value:.6f}" for value in (*pose[:3, 3], *quaternion))]
        )
        + "\n"
    )


def write_folder(folder: Path, images: FloatArray, poses: FloatArray) -> None:
    """Write a sequence: depth.txt, rgb.txt, groundtruth.txt with a pose every 10 ms, accelerometer.txt."""
    depths = np.round(TUM_SCALE * images).astype(np.uint16)
    for kind, pictures in (
        ("depth", depths),
        ("rgb", np.zeros((len(images), 480, 640, 3), np.uint8)),
    ):
        (folder / kind).mkdir()
        lines = HEADER.format(f"{kind} maps", "filename")
        for number, picture in enumerate(pictures):
            stamp = f"{START + number / 30:.6f}"
            Image.fromarray(picture).save(folder / kind / f"{stamp}.png")
            lines += f"{stamp} {kind}/{stamp}.png\n"
        (folder / f"{kind}.txt").write_text(lines)
    lines = HEADER.format("ground truth trajectory", "tx ty tz qx qy qz qw")
    # The tracking system takes a hundred poses a second: there is one before each image, and one after it.
    for number, pose in enumerate(poses):
        lines += "".join(
            pose_line(START + number / 30 + late, pose) for late in (-0.004, 0.006)
        )
    (folder / "groundtruth.txt").write_text(lines)
    accelerometer = "".join(f"{START + k / 100:.6f} -0.5 8.1 -4.0\n" for k in range(20))
    (folder / "accelerometer.txt").write_text(
        HEADER.format("accelerometer data", "ax ay az") + accelerometer
    )


@pytest.mark.slow
def test_poses_of_a_folder_are_where_registration_starts(tmp_path: Path) -> None:
    """The poses in groundtruth.txt have errors of 1 degree and 1 cm."""
    rng = np.random.default_rng(0)
    images, motions = turning_frames(body(), TUM_CAMERA, rng)
    truth = np.linalg.inv(motions).astype(np.float64)
    given = truth.copy()
    given[1:, :3, :3] @= Rotation.from_rotvec([0, np.radians(1), 0]).as_matrix()
    given[1:, :3, 3] += rng.normal(0, 0.01 / np.sqrt(3), (len(given) - 1, 3))
    write_folder(tmp_path, images, given)
    kept = pcretrieve.merge_views(
        tmp_path, DEPTH_CAMERA.model_copy(update={"refine": False})
    )
    np.testing.assert_allclose(kept.poses, given, atol=1e-5)
    refined = pcretrieve.merge_views(tmp_path, DEPTH_CAMERA)
    assert refined.left_out == ()
    at_its_range = np.array([[0, 0, 2.4], [0, 0.8, 2.4], [0.3, 0, 2.4]])
    before, after = (
        error(poses, truth, at_its_range) for poses in (given, refined.poses)
    )
    assert before > 0.01
    assert after < 0.5 * before


def test_associations_have_poses_or_times(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = (
        Rotation.random(2, rng=rng).as_matrix(),
        rng.normal(size=(2, 3)),
    )
    images = [tmp_path / "depth" / name for name in ("1.png", "2.png")]
    associations, trajectory = tmp_path / "associations.txt", tmp_path / "groundtruth.txt"
    # associate.py depth.txt groundtruth.txt
    with_poses = [
        f"{10 + k} depth/{k + 1}.png {pose_line(10.015 + k, pose)}"
        for k, pose in enumerate(poses)
    ]
    associations.write_text("".join(with_poses))
    assert trajectory_file(images) == associations
    np.testing.assert_allclose(
        np.array(image_poses(images, associations)), poses, atol=1e-5
    )
    # associate.py rgb.txt depth.txt, with the poses in a file of their own
    associations.write_text(
        "10.01 rgb/a.png 10.0 depth/1.png\n11.01 rgb/b.png 11.0 depth/2.png\n"
    )
    assert trajectory_file(images) is None
    trajectory.write_text(
        "".join(pose_line(10.01 + k, pose) for k, pose in enumerate(poses))
    )
    assert trajectory_file(images) == trajectory
    np.testing.assert_allclose(
        np.array(image_poses(images, trajectory)), poses, atol=1e-5
    )
    for line, words in (
        (
            "1 2 3 4 0 0 0 x",
            "the lines of groundtruth.txt must end in `t tx ty tz qx qy qz qw`, eight finite",
        ),
        ("1 2 3 4 0 0 0 0", "with a quaternion that is not zero"),
        ("1 nan 3 4 0 0 0 1", "eight finite numbers"),
    ):
        trajectory.write_text(line)
        with pytest.raises(ScanReadError, match=words):
            image_poses(images, trajectory)
