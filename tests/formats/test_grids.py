"""Depth images and PTX files: points, normals and sensors of grids of readings."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import open3d
import pytest
from numpy.typing import NDArray
from PIL import Image
from scan_files import POSE, cloud
from scipy.spatial.transform import Rotation

from pcretrieve import PointCloud, read_scan
from pcretrieve.errors import ScanReadError
from pcretrieve.formats import ScanPath, is_scan, members_of, parts_of
from pcretrieve.formats.depth import KINECTS, TUM_CAMERAS, camera_of
from pcretrieve.formats.identity import content_hash
from pcretrieve.formats.registry import read_raw
from pcretrieve.ingestion.discover import discover
from pcretrieve.ingestion.views import read_views

WIDTH, HEIGHT = 80, 60
FX, FY, CX, CY = 70.0, 72.0, 38.0, 31.0
CENTER, RADIUS = np.array([0.1, -0.05, 1.5]), 0.4  # of a ball, in metres
FLAT = f"fx = {FX}\nfy = {FY}\ncx = {CX}\ncy = {CY}\n"
OPEN3D = {
    "width": WIDTH,
    "height": HEIGHT,
    "intrinsic_matrix": [FX, 0, 0, 0, FY, 0, CX, CY, 1],
}


def readings(
    camera: tuple[float, float, float, float] = (FX, FY, CX, CY),
    size: tuple[int, int] = (WIDTH, HEIGHT),
    wall: float = 0.0,
) -> NDArray[np.float64]:
    """(h, w, 3) points of a ball before a wall of that depth, in metres; zero where there is none."""
    fx, fy, cx, cy = camera
    u, v = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    # With depth 1.
    rays = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones(u.shape)], axis=2)
    a, b = (rays**2).sum(axis=2), rays @ CENTER
    inside = b**2 - a * (CENTER @ CENTER - RADIUS**2)
    return (
        rays
        * np.where(inside > 0, (b - np.sqrt(np.maximum(inside, 0))) / a, wall)[..., None]
    )


def write(path: Path, image: NDArray[Any]) -> None:
    if path.suffix == ".npy":
        np.save(path, image)
    else:
        Image.fromarray(image).save(path)


def is_ball(found: PointCloud, tolerance: float) -> bool:
    """Whether points, normals and sensors are those of the ball, seen from the origin."""
    assert found.normals is not None
    assert found.viewpoints is not None
    outward = found.points - CENTER
    distance = np.linalg.norm(outward, axis=1)
    outward /= distance[:, None]
    # Away from the silhouette, where the surface is seen from the side.
    facing = np.einsum("ij,ij->i", outward, -found.points) > 0.5 * np.linalg.norm(
        found.points, axis=1
    )
    cosine = np.einsum("ij,ij->i", outward[facing], found.normals[facing])
    return bool(
        len(found.points) > 300
        and np.abs(distance - RADIUS).max() < tolerance
        and cosine.mean() > 0.99
        and not found.viewpoints.any()
    )


DEPTH = readings()[..., 2]
MILLIMETRES = np.round(1000 * DEPTH).astype(np.uint16)


def test_millimetres_and_metres(tmp_path: Path) -> None:
    (tmp_path / "camera.toml").write_text(FLAT)
    for name, image in (
        *(
            ("a.png", MILLIMETRES),
            ("a.tif", MILLIMETRES),
            ("a.tiff", DEPTH.astype(np.float32)),
        ),
        *(("a.npy", MILLIMETRES), ("a.npy", DEPTH)),
        ("a.npy", np.where(DEPTH > 0, DEPTH, np.nan).astype(np.float32)),
    ):
        write(tmp_path / name, image)
        assert is_ball(cloud(tmp_path / name), tolerance=1e-3), name
        assert read_raw(ScanPath.parse(tmp_path / name)).unit == "m"
        assert is_scan(ScanPath.parse(tmp_path / name))


CAMERAS = {
    "a.json": json.dumps({"fx": FX, "fy": FY, "cx": CX, "cy": CY}),
    "a.toml": FLAT,
    "camera.json": json.dumps(OPEN3D),
    "camera_intrinsic.json": json.dumps(OPEN3D),
    "intrinsics.json": json.dumps(
        {"intrinsic": OPEN3D, "extrinsic": np.eye(4).ravel().tolist()}
    ),
    "intrinsic.json": json.dumps(
        {"fx": FX, "fy": FY, "ppx": CX, "ppy": CY, "depth_units": 0.001}
    ),
    "camera.toml": f"K = [{FX}, 0, {CX}, 0, {FY}, {CY}, 0, 0, 1]",
    "intrinsics.toml": f"depth_scale = 1e3\nintrinsic_matrix = [[{FX}, 0, {CX}], [0, {FY}, {CY}], [0, 0, 1]]",
}


def test_where_the_camera_is_found(tmp_path: Path) -> None:
    (tmp_path / "depth").mkdir()
    image = tmp_path / "depth" / "a.png"
    write(image, MILLIMETRES)
    for name, text in CAMERAS.items():
        file = (image.parent if name.startswith("a.") else tmp_path) / name
        file.write_text(text)
        assert is_scan(ScanPath.parse(image))
        assert is_ball(cloud(image), tolerance=1e-3), name
        assert [part.path for part in parts_of(image)] == [file.absolute()]
        before = content_hash(ScanPath.parse(image))
        file.write_text(text.replace("70", "71"))
        assert content_hash(ScanPath.parse(image)) != before
        file.unlink()


def test_a_scale_below_1_is_metres_per_value(tmp_path: Path) -> None:
    """As librealsense writes it: .00025 is a quarter of a millimetre."""
    write(tmp_path / "a.png", np.round(DEPTH / 0.00025).astype(np.uint16))
    for scale in (0.0002500000118743628, 4000):
        (tmp_path / "camera.json").write_text(json.dumps(OPEN3D | {"depth_scale": scale}))
        found = cloud(tmp_path / "a.png")
        assert is_ball(found, tolerance=1e-3)
        said = "read depth_scale 0.00025 as metres per value, not values per metre: it is below 1"
        assert (said in found.provenance[0].notes) == (scale < 1)


def test_the_folder_of_the_tum_benchmark(tmp_path: Path) -> None:
    folder = tmp_path / "rgbd_dataset_freiburg2_desk"
    (folder / "depth").mkdir(parents=True)
    (folder / "depth.txt").write_text("# depth maps\n1.0 depth/1.0.png\n")
    (folder / "groundtruth.txt").write_text(
        "# timestamp tx ty tz qx qy qz qw\n" + "1 0 0 0 0 0 0 1\n" * 9
    )
    camera = TUM_CAMERAS["freiburg2"]
    image = readings((*camera.focal, *camera.center), (640, 480))[..., 2]
    write(folder / "depth" / "1.0.png", np.round(5000 * image).astype(np.uint16))
    assert discover([folder]) == [ScanPath(folder / "depth" / "1.0.png")]
    assert is_ball(cloud(folder / "depth" / "1.0.png"), tolerance=1e-3)


def test_the_default_is_the_camera_of_a_kinect_for_images_of_its_size(
    tmp_path: Path,
) -> None:
    for size, camera in KINECTS.items():
        assert size is not None
        image = readings((*camera.focal, *camera.center), size)[..., 2]
        write(tmp_path / "a.png", np.round(1000 * image).astype(np.uint16))
        found = cloud(tmp_path / "a.png")
        assert is_ball(found, tolerance=1e-3)
        assert found.provenance[0].notes[0] == camera.note
        assert camera.note.startswith("assumed the camera of a Kinect")
    # A 16-bit image in a folder need not be a depth image.
    assert not is_scan(ScanPath(tmp_path / "a.png"))


def test_readings_without_an_answer_are_dropped_with_a_note(tmp_path: Path) -> None:
    image = MILLIMETRES.copy()
    image[:5] = 65535
    write(tmp_path / "a.png", image)
    (tmp_path / "camera.toml").write_text(FLAT)
    found = cloud(tmp_path / "a.png")
    assert found.points[:, 2].max() < 2
    n_missing = int((MILLIMETRES[5:] == 0).sum()) + 5 * WIDTH
    assert found.provenance[0].notes[0] == (
        f"dropped {n_missing} of {WIDTH * HEIGHT} readings without an answer"
    )


def test_a_camera_that_cannot_be_read(tmp_path: Path) -> None:
    write(tmp_path / "a.png", MILLIMETRES)
    for name, text, words in (
        (
            "camera.json",
            "{",
            "the camera file camera.json must have intrinsic_matrix as Open3D writes it",
        ),
        (
            "camera.json",
            json.dumps(OPEN3D | {"width": 81}),
            r"the camera has \(81, 60\) pixels, the image has",
        ),
        (
            "camera.toml",
            FLAT.replace("70", "-70"),
            "focal lengths and the depth scale must be positive",
        ),
        (
            "camera.toml",
            FLAT + "depth_scale = 0\n",
            "focal lengths and the depth scale must be positive",
        ),
        ("camera.toml", FLAT + "#" * (1 << 16), "must have at most 65536 bytes"),
        ("other.toml", FLAT, "needs the parameters of its camera: put "),
    ):
        (tmp_path / name).write_text(text)
        with pytest.raises(ScanReadError, match=words):
            read_scan(tmp_path / "a.png")
        (tmp_path / name).unlink()


def test_images_that_are_no_depth_images(tmp_path: Path) -> None:
    (tmp_path / "camera.toml").write_text(FLAT)
    write(tmp_path / "colours.png", np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8))
    write(tmp_path / "empty.png", np.zeros((HEIGHT, WIDTH), dtype=np.uint16))
    (tmp_path / "text.png").write_text("1 2 3\n")
    for name, words in (
        ("colours.png", "must have one channel of 16 or 32 bits, this image is RGB"),
        ("empty.png", "none of its 4800 readings is an answer"),
        ("text.png", "not a valid PNG file"),
    ):
        with pytest.raises(ScanReadError, match=words):
            read_scan(tmp_path / name)
    assert not is_scan(ScanPath.parse(tmp_path / "colours.png"))
    assert not is_scan(ScanPath.parse(tmp_path / "text.png"))


def test_the_parameters_of_open3d_are_read_by_columns(tmp_path: Path) -> None:
    intrinsic = open3d.camera.PinholeCameraIntrinsic(WIDTH, HEIGHT, FX, FY, CX, CY)
    open3d.io.write_pinhole_camera_intrinsic(tmp_path / "camera.json", intrinsic)
    assert camera_of(tmp_path / "camera.json") == (
        (FX, FY),
        (CX, CY),
        None,
        (WIDTH, HEIGHT),
        "",
    )


# --- PTX --------------------------------------------------------------------------------------------------

SENSOR, TURN = np.array([10.0, -20.0, 3.0]), Rotation.from_euler("zyx", [0.4, -0.2, 1.1])
WALL = 4.0  # depth; metres


def ptx(turn: Rotation, sensor: NDArray[np.float64], grid: NDArray[np.float64]) -> str:
    """A header of ten lines and the readings; points are rows, so that the matrix is transposed."""
    axes = turn.as_matrix().T
    rows = [*grid.shape[:2], sensor, *axes, *([*axis, 0] for axis in axes), [*sensor, 1]]
    head = "".join(
        " ".join(f"{value:.9g}" for value in np.atleast_1d(row)) + "\n" for row in rows
    )
    return head + "".join(
        "{:.9g} {:.9g} {:.9g} 0.5 1 2 3\n".format(*row) for row in grid.reshape(-1, 3)
    )


def test_readings_of_ptx_in_the_common_frame(tmp_path: Path) -> None:
    """Between a body and its background a sensor measures points on neither surface."""
    grid = readings(wall=WALL)
    grid[:5] = 0
    grid[50, 60] *= 0.5  # stands alone
    (tmp_path / "a.ptx").write_text(ptx(TURN, SENSOR, grid))
    found = cloud(tmp_path / "a.ptx")
    assert found.viewpoints is not None
    assert found.normals is not None
    own, normals = (
        (found.points - SENSOR) @ TURN.as_matrix(),
        found.normals @ TURN.as_matrix(),
    )
    on_wall = np.abs(own[:, 2] - WALL) < 1e-6
    np.testing.assert_allclose(
        normals[on_wall], np.tile([0, 0, -1.0], (on_wall.sum(), 1)), atol=1e-6
    )
    assert is_ball(
        PointCloud(
            own[~on_wall], normals[~on_wall], (found.viewpoints - SENSOR)[~on_wall]
        ),
        1e-6,
    )
    assert np.einsum("ij,ij->i", normals, -own).min() >= 0
    missing, alone = found.provenance[0].notes
    assert (
        missing == f"dropped {5 * WIDTH} of {WIDTH * HEIGHT} readings without an answer"
    )
    assert "points without three neighbours on a surface" in alone


def test_scans_of_one_file_are_joined_by_the_poses_of_their_sensors(
    tmp_path: Path,
) -> None:
    one, other = (
        ptx(TURN, SENSOR, readings()),
        ptx(Rotation.identity(), np.zeros(3), readings()),
    )
    for name, text in (("one", one), ("both", one + other), ("loose", other + other)):
        (tmp_path / f"{name}.ptx").write_text(text)
    alone, both = cloud(tmp_path / "one.ptx"), cloud(tmp_path / "both.ptx")
    n = len(alone.points)
    assert both.viewpoints is not None
    np.testing.assert_array_equal(both.points[:n], alone.points)
    np.testing.assert_allclose(
        both.points[n:] @ TURN.as_matrix().T + SENSOR, alone.points, atol=1e-6
    )
    np.testing.assert_array_equal(both.viewpoints, [SENSOR] * n + [np.zeros(3)] * n)
    members = members_of(tmp_path / "both.ptx")
    assert [scan.name for scan in members] == ["both.ptx#1", "both.ptx#2"]
    first, second = (cloud(Path(str(scan))) for scan in members)
    np.testing.assert_array_equal(first.points, alone.points)
    np.testing.assert_array_equal(second.points, both.points[n:])
    assert members_of(tmp_path / "one.ptx") == ()
    np.testing.assert_array_equal(
        read_views([tmp_path / "both.ptx"]).poses, [np.eye(4), np.eye(4)]
    )
    loose = read_views([tmp_path / "loose.ptx"])
    assert len(loose.clouds) == 2
    assert loose.poses is None


def test_points_of_ptx_that_are_no_grid(tmp_path: Path) -> None:
    """Programs write a cloud without a grid as one row or column, which has no neighbours of a surface."""
    points = np.random.default_rng(0).uniform(1, 2, (50, 3))
    points[7] = 0
    for grid in (points[None], points[:, None]):
        for sensor in (np.zeros(3), SENSOR):
            (tmp_path / "a.ptx").write_text(ptx(TURN, sensor, grid))
            found = cloud(tmp_path / "a.ptx")
            own = (found.points - sensor) @ TURN.as_matrix()
            np.testing.assert_allclose(own, np.delete(points, 7, axis=0), atol=1e-6)
            assert found.normals is None
            assert (found.viewpoints is None) == (not sensor.any())
            said = "dropped 1 of 50 readings without an answer"
            assert found.provenance[0].notes == (said,)


def test_blank_lines_between_the_scans_of_ptx(tmp_path: Path) -> None:
    one = ptx(TURN, SENSOR, readings())
    (tmp_path / "a.ptx").write_text(one)
    (tmp_path / "b.ptx").write_text(f"\n{one}\n\n{one}\n".replace("\n", "\r\n"))
    both = np.tile(cloud(tmp_path / "a.ptx").points, (2, 1))
    np.testing.assert_array_equal(cloud(tmp_path / "b.ptx").points, both)


ONE_GRID = ptx(TURN, SENSOR, readings(wall=WALL)[::8, ::8])
LINES = ONE_GRID.splitlines()
NO_ANSWER = ptx(TURN, SENSOR, np.zeros((4, 5, 3)))
DIALECTS = {
    "tabs": ONE_GRID.replace(" ", "\t"),
    "blanks round rows": "  " + ONE_GRID.replace("\n", "  \n  "),
    "ends of lines of old Macs": ONE_GRID.replace("\n", "\r"),
    "a mark of UTF-8": "\ufeff" + ONE_GRID,
    "four columns": "\n".join(LINES[:10] + [row.rsplit(" ", 3)[0] for row in LINES[10:]]),
    "colours of some": "\n".join(
        LINES[:10] + [row.rsplit(" ", 3 * (k % 2))[0] for k, row in enumerate(LINES[10:])]
    ),
    "a station without an answer": NO_ANSWER + ONE_GRID,
    "a station without a grid": "\n".join(["0", "0", *LINES[2:10], *LINES]),
}


@pytest.mark.parametrize("dialect", DIALECTS)
def test_dialects_of_ptx(dialect: str, tmp_path: Path) -> None:
    (tmp_path / "a.ptx").write_text(ONE_GRID)
    (tmp_path / "b.ptx").write_bytes(DIALECTS[dialect].encode())
    expected, found = cloud(tmp_path / "a.ptx"), cloud(tmp_path / "b.ptx")
    np.testing.assert_array_equal(found.points, expected.points)
    np.testing.assert_array_equal(found.normals, expected.normals)
    np.testing.assert_array_equal(found.viewpoints, expected.viewpoints)


def test_a_pose_of_ptx_with_decimal_commas_is_named(tmp_path: Path) -> None:
    pose = "\n".join(line.replace(".", ",") for line in LINES[:10])
    (tmp_path / "a.ptx").write_text("\n".join([pose, *LINES[10:]]))
    with pytest.raises(ScanReadError, match="export it with decimal points, not commas"):
        read_scan(tmp_path / "a.ptx")


def test_a_file_that_is_refused_is_closed(tmp_path: Path) -> None:
    """Else Windows would not let it be replaced, as long as somebody has the error."""
    grid = f"2\n2\n{POSE}" + "0 0 1\n" * 3
    (tmp_path / "a.ptx").write_text(grid)
    with pytest.raises(ScanReadError, match="declares 4 points, it holds 3") as raised:
        read_scan(tmp_path / "a.ptx")
    opened = [link.resolve() for link in Path("/proc/self/fd").iterdir()]
    assert tmp_path / "a.ptx" not in opened
    assert raised.value.__traceback__ is not None
