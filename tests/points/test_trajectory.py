"""Poses of depth images in folders as the tools of the TUM RGB-D benchmark write them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapes
from PIL import Image
from scipy.spatial.transform import Rotation

import pcretrieve
from pcretrieve.errors import ScanReadError
from pcretrieve.formats.conf import image_poses, trajectory_file
from pcretrieve.points.register.alignment import moved
from pcretrieve.simulation.turning import TurningOptions, turning_frames
from pcretrieve.values import FloatArray

# The camera that TUM recommends as a default, and its unit of depth; 1/m.
CAMERA = TurningOptions(n_frames=3, turn=90, width=640, height=480, focal=525.0)
TUM_SCALE = 5000

START = 1305031102.1604
HEADER = "# {}\n# file: 'rgbd_dataset_freiburg1_xyz.bag'\n# timestamp {}\n"


def stamp(number: int) -> str:
    """The time of an image, with the six digits of the names of TUM's images."""
    return f"{START + number / 30:.6f}"


def pose_line(time: float, pose: FloatArray) -> str:
    """A line of groundtruth.txt, with four digits, and more of the pose."""
    quaternion = Rotation.from_matrix(pose[:3, :3]).as_quat()
    return " ".join([f"{time:.4f}", *(f"{value:.6f}" for value in (*pose[:3, 3], *quaternion))])


def write_folder(folder: Path, images: FloatArray, poses: FloatArray) -> list[Path]:
    """Write a sequence: depth.txt, rgb.txt, groundtruth.txt with a pose every 10 ms, accelerometer.txt."""
    names = []
    for kind in ("depth", "rgb"):
        (folder / kind).mkdir(parents=True)
        names = [f"{kind}/{stamp(number)}.png" for number in range(len(images))]
        lines = [f"{stamp(number)} {name}\n" for number, name in enumerate(names)]
        (folder / f"{kind}.txt").write_text(HEADER.format(f"{kind} maps", "filename") + "".join(lines))
    files = []
    for number, image in enumerate(images):
        files.append(folder / "depth" / f"{stamp(number)}.png")
        Image.fromarray(np.round(TUM_SCALE * image).astype(np.uint16)).save(files[-1])
        Image.fromarray(np.zeros((480, 640, 3), np.uint8)).save(folder / "rgb" / files[-1].name)
    # The tracking system takes a hundred poses a second: there is one before each image, and one after it.
    lines = [
        pose_line(START + number / 30 + late, pose)
        for number, pose in enumerate(poses)
        for late in (-0.004, 0.006)
    ]
    header = HEADER.format("ground truth trajectory", "tx ty tz qx qy qz qw")
    (folder / "groundtruth.txt").write_text(header + "\n".join(lines) + "\n")
    accelerometer = "".join(f"{START + k / 100:.6f} -0.5 8.1 -4.0\n" for k in range(20))
    (folder / "accelerometer.txt").write_text(HEADER.format("accelerometer data", "ax ay az") + accelerometer)
    return files


@pytest.fixture(scope="module")
def sequence(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, FloatArray, FloatArray]:
    """The folder, the true poses, and the poses in groundtruth.txt, with errors of 1 degree and 1 cm."""
    mesh = shapes.body()
    body = replace(mesh, vertices=1.7 * mesh.vertices / np.ptp(mesh.vertices[:, 1]))
    rng = np.random.default_rng(0)
    images, motions = turning_frames(body, CAMERA, rng)
    truth = np.linalg.inv(motions).astype(np.float64)
    given = truth.copy()
    given[1:, :3, :3] @= Rotation.from_rotvec([0, np.radians(1), 0]).as_matrix()
    given[1:, :3, 3] += rng.normal(0, 0.01 / np.sqrt(3), (len(given) - 1, 3))
    folder = tmp_path_factory.mktemp("tum")
    write_folder(folder, images, given)
    return folder, truth, given


def error(poses: FloatArray, truth: FloatArray) -> float:
    """Largest distance of a point at the range of the body from its place; m."""
    points = np.array([[0, 0, 2.4], [0, 0.8, 2.4], [0.3, 0, 2.4]])
    return float(np.linalg.norm(moved(poses, points) - moved(truth, points), axis=2).max())


@pytest.mark.slow
def test_poses_of_a_folder_are_where_registration_starts(
    sequence: tuple[Path, FloatArray, FloatArray],
) -> None:
    folder, truth, given = sequence
    options = pcretrieve.PipelineOptions.of("depth-camera").merge
    kept = pcretrieve.merge_views(folder, options.model_copy(update={"refine": False}))
    np.testing.assert_allclose(kept.poses, given, atol=1e-5)
    refined = pcretrieve.merge_views(folder, options)
    assert refined.left_out == ()
    assert error(given, truth) > 0.01
    assert error(refined.poses, truth) < 0.5 * error(given, truth)


def test_associations_have_poses_or_times(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = Rotation.random(2, rng=rng).as_matrix(), rng.normal(size=(2, 3))
    images = [tmp_path / "depth" / name for name in ("1.png", "2.png")]
    # associate.py depth.txt groundtruth.txt
    with_poses = [
        f"{10 + k} depth/{image.name} {pose_line(10.015 + k, pose)}"
        for k, (image, pose) in enumerate(zip(images, poses, strict=True))
    ]
    (tmp_path / "associations.txt").write_text("\n".join(with_poses))
    file = trajectory_file(images)
    assert file == tmp_path / "associations.txt"
    np.testing.assert_allclose(np.array(image_poses(images, file)), poses, atol=1e-5)
    # associate.py rgb.txt depth.txt, with the poses in a file of their own
    (tmp_path / "associations.txt").write_text(
        "10.01 rgb/a.png 10.0 depth/1.png\n11.01 rgb/b.png 11.0 depth/2.png\n"
    )
    assert trajectory_file(images) is None
    (tmp_path / "groundtruth.txt").write_text(
        "\n".join(pose_line(10.01 + k, pose) for k, pose in enumerate(poses))
    )
    file = trajectory_file(images)
    assert file == tmp_path / "groundtruth.txt"
    np.testing.assert_allclose(np.array(image_poses(images, file)), poses, atol=1e-5)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (
            "1 2 3 4 0 0 0 x",
            "the lines of groundtruth.txt must end in `t tx ty tz qx qy qz qw`, eight finite",
        ),
        ("1 2 3 4 0 0 0 0", "with a quaternion that is not zero"),
        ("1 nan 3 4 0 0 0 1", "eight finite numbers"),
    ],
)
def test_poses_that_cannot_be_read(line: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "depth").mkdir()
    image = tmp_path / "depth" / "1.png"
    (tmp_path / "depth.txt").write_text("1.0 depth/1.png\n")
    (tmp_path / "groundtruth.txt").write_text(line + "\n")
    file = trajectory_file([image])
    assert file is not None
    with pytest.raises(ScanReadError, match=words):
        image_poses([image], file)
