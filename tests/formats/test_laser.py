"""LAS, LAZ and E57: what the libraries that are usual for them have written is read again."""

from __future__ import annotations

import socket
import struct
import subprocess
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapes
from benchmarks.samples import write_conf, write_pcd
from numpy.typing import NDArray
from scan_files import (
    CAN_WRITE,
    cloud,
    laser_scan,
    needs,
    with_other_xml,
    write_e57,
    write_las,
)
from scipy.spatial.transform import Rotation

from pcretrieve import PointCloud, read_scan
from pcretrieve.errors import ScanReadError
from pcretrieve.formats import ScanPath, as_scan, members_of, parts_of, write_mesh
from pcretrieve.formats.registry import read_raw
from pcretrieve.ingestion.views import read_views
from pcretrieve.values import FloatArray

POINTS = shapes.points_on(shapes.ellipsoid(), 500)
SINGLE = 1e-6
LAS_STEP = 1e-4  # of the coordinates in the files of the tests


# --- LAS and LAZ ------------------------------------------------------------------------------------------


@needs(".laz")
def test_points_of_las(tmp_path: Path) -> None:
    """LASzip writes chunks of 50,000 points."""
    many = np.random.default_rng(3).uniform(-9, 9, (120_000, 3))
    classes = [7, 1, 2, *([0] * (len(POINTS) - 3))]
    for suffix in (".las", ".laz"):
        for point_format in (0, 1, 2, 3, 6, 7, 8):
            write_las(tmp_path / f"a{suffix}", POINTS, point_format=point_format)
            np.testing.assert_allclose(
                cloud(tmp_path / f"a{suffix}").points, POINTS, atol=LAS_STEP
            )
            assert read_raw(ScanPath.parse(tmp_path / f"a{suffix}")).unit == "m"
        for point_format in (3, 6):
            write_las(tmp_path / f"a{suffix}", many, point_format=point_format)
            np.testing.assert_allclose(
                cloud(tmp_path / f"a{suffix}").points, many, atol=LAS_STEP
            )
            write_las(
                tmp_path / f"a{suffix}",
                POINTS,
                point_format=point_format,
                classes=classes,
            )
            found = cloud(tmp_path / f"a{suffix}")
            np.testing.assert_allclose(found.points, POINTS[1:], atol=LAS_STEP)
            assert (
                found.provenance[0]
                .notes[0]
                .startswith("dropped 1 of 500 points that the file calls noise")
            )


@needs(".las")
@pytest.mark.parametrize("point_format", [1, 6])
def test_points_of_las_that_are_not_measured(point_format: int, tmp_path: Path) -> None:
    """Withheld ones were deleted by an editor; a scanner without an answer writes zeros."""
    import laspy

    path = tmp_path / "a.las"
    write_las(path, [*POINTS, *np.zeros((9, 3))], point_format=point_format)
    data = laspy.read(str(path))
    data.withheld = np.arange(len(data.x)) < 4
    data.write(str(path))
    found = cloud(path)
    np.testing.assert_allclose(found.points, POINTS[4:], atol=LAS_STEP)
    withheld, zeros = found.provenance[0].notes
    assert withheld == "dropped 4 of 509 points that the file calls noise or withheld"
    assert zeros.startswith("dropped 9 of 505 points at zero")
    # A file that calls all of its points noise says nothing by it.
    data.withheld = np.ones(len(data.x), dtype=bool)
    data.write(str(path))
    assert len(cloud(path).points) == len(POINTS)


@needs(".laz")
def test_a_unit_that_is_given_is_used_or_a_note_says_why_not(tmp_path: Path) -> None:
    """LAS has no unit: metres are only usual. The specification of glTF names metres."""
    write_las(tmp_path / "a.las", 1000 * POINTS)
    usual, given = as_scan(tmp_path / "a.las"), as_scan(tmp_path / "a.las", "mm")
    assert isinstance(usual, PointCloud) and isinstance(given, PointCloud)
    np.testing.assert_allclose(given.points * 1000, usual.points)
    assert given.provenance[0].notes == (
        "--unit mm is applied, though such files usually have m",
        "converted the coordinates from mm to m",
    )
    ball = shapes.icosphere(1)
    write_mesh(ball, tmp_path / "a.glb")
    found = as_scan(tmp_path / "a.glb", "mm")
    assert found.provenance[0].notes == (
        "--unit mm is not applied, because the file names its unit, m",
    )
    assert as_scan(tmp_path / "a.glb", "m").provenance[0].notes == ()
    assert found.diagonal == pytest.approx(ball.diagonal)


def test_damaged_headers_and_chunks(tmp_path: Path) -> None:
    write_las(tmp_path / "a.las", POINTS)
    write_las(tmp_path / "a.laz", POINTS, point_format=6)
    las, laz = (tmp_path / "a.las").read_bytes(), (tmp_path / "a.laz").read_bytes()
    # lazrs would allocate the layers of a chunk that take more than the chunk, and end the process.
    layers = struct.unpack_from("<I", laz, 96)[0] + 8 + 30 + 4
    for whole, at, value, words in (
        (las, 24, b"\2", "its header says version 2.2"),
        (las, 96, struct.pack("<I", 10**9), "its points begin at byte 1000000000"),
        (
            las,
            100,
            struct.pack("<I", 2**32 - 1),
            "its header declares 4294967295 records in 0 bytes",
        ),
        # It has one record of 94 bytes, that of LASzip.
        (laz, 100, struct.pack("<I", 2), "its header declares 2 records in 94 bytes"),
        (
            las,
            107,
            struct.pack("<I", 2**32 - 1),
            "its header declares 4294967295 points, 17000 bytes follow",
        ),
        (las, 131, struct.pack("<d", np.nan), "its scale is not finite"),
        (laz[:-100], 0, b"", "its chunks are listed at byte"),
        (laz, layers, struct.pack("<I", 2**32 - 1), "the layers of a chunk have 42949"),
    ):
        path = tmp_path / ("b.las" if whole is las else "b.laz")
        path.write_bytes(whole[:at] + value + whole[at + len(value) :])
        with pytest.raises(ScanReadError, match=words):
            read_scan(path)
    for suffix in (".las", ".laz", ".e57") if CAN_WRITE[".e57"] else (".las", ".laz"):
        for content in (laser_scan(tmp_path, suffix), b"1 2 3\n", bytes(4096)):
            (tmp_path / f"c{suffix}").write_bytes(content)
            with pytest.raises(ScanReadError, match=r"not a (complete|valid)"):
                read_scan(tmp_path / f"c{suffix}")
            # pye57 removes files that it cannot write.
            assert (tmp_path / f"c{suffix}").read_bytes() == content


# --- E57 --------------------------------------------------------------------------------------------------

TURN = Rotation.from_euler("xyz", [0.3, -0.5, 1.0])
QUATERNION = np.roll(TURN.as_quat(), 1)  # w first
SENSOR = np.array([4.0, -5.0, 1.5])


@needs(".e57")
def test_the_pose_of_an_e57_scan_is_its_viewpoint(tmp_path: Path) -> None:
    write_e57(
        tmp_path / "a.e57",
        [{"points": POINTS, "rotation": QUATERNION, "translation": SENSOR}],
    )
    found = cloud(tmp_path / "a.e57")
    np.testing.assert_allclose(
        found.points, POINTS @ TURN.as_matrix().T + SENSOR, atol=10 * SINGLE
    )
    assert found.viewpoints is not None
    np.testing.assert_allclose(found.viewpoints, np.tile(SENSOR, (len(POINTS), 1)))
    assert members_of(tmp_path / "a.e57") == ()
    assert read_raw(ScanPath.parse(tmp_path / "a.e57")).unit == "m"


@needs(".e57")
def test_the_default_pose_is_that_of_a_sensor_if_the_points_are_a_grid(
    tmp_path: Path,
) -> None:
    index = np.arange(len(POINTS)).astype(np.uint16)
    grid = {"rowIndex": index % 25, "columnIndex": index // 25}
    write_e57(tmp_path / "grid.e57", [{"points": POINTS + 9, **grid}])
    write_e57(tmp_path / "plain.e57", [{"points": POINTS + 9}])
    np.testing.assert_array_equal(
        cloud(tmp_path / "grid.e57").viewpoints, np.zeros((len(POINTS), 3))
    )
    assert cloud(tmp_path / "plain.e57").viewpoints is None


@needs(".e57")
def test_scans_in_an_e57_file(tmp_path: Path) -> None:
    scans = [
        {"points": POINTS, "name": "front", "translation": SENSOR},
        {"points": POINTS[:100], "name": "front", "translation": -SENSOR},
    ]
    write_e57(tmp_path / "a.e57", scans)
    members = members_of(tmp_path / "a.e57")
    assert [scan.name for scan in members] == ["a.e57#front", "a.e57#front-2"]
    first, second = (cloud(Path(str(scan))) for scan in members)
    assert (len(first.points), len(second.points)) == (500, 100)
    both = cloud(tmp_path / "a.e57")
    np.testing.assert_array_equal(both.points[500:], second.points)
    assert both.viewpoints is not None
    np.testing.assert_allclose(both.viewpoints[[0, 500]], [SENSOR, -SENSOR])
    views = read_views([tmp_path / "a.e57"])
    np.testing.assert_array_equal(views.poses, [np.eye(4), np.eye(4)])


Fields = dict[str, tuple[str, NDArray[Any]]]
Pose = dict[str, dict[str, float]]
# The prefix of an extension, by which CloudCompare writes normals, and its address.
NORMALS_OF_E57 = ("nor", "http://www.libe57.org/E57_NOR_surface_normals.txt")


def write_fields(path: Path, scans: Sequence[Fields], pose: Pose | None = None) -> None:
    """Scans of any fields, each as doubles, as scaled integers, or as states 0 to 2.

    pose: the parts of the pose of each scan, in their order.
    """
    from pye57 import E57, libe57

    with E57(str(path), "w") as file:
        image = file.image_file
        for fields in scans:
            scan, row = libe57.StructureNode(image), libe57.StructureNode(image)
            buffers, arrays = libe57.VectorSourceDestBuffer(), []
            for name, (kind, values) in fields.items():
                if kind == "double":
                    node = libe57.FloatNode(image, 0.0, libe57.E57_DOUBLE, -1e9, 1e9)
                elif kind == "scaled":
                    node = libe57.ScaledIntegerNode(image, 0, -(10**8), 10**8, 1e-5, 3.0)
                else:
                    node = libe57.IntegerNode(image, 0, 0, 2)
                if ":" in name:
                    image.extensionsAdd(*NORMALS_OF_E57)
                row.set(name, node)
                arrays.append(np.array(values, "i1" if kind == "state" else "f8"))
                buffers.append(
                    libe57.SourceDestBuffer(
                        image, name, arrays[-1], len(values), True, kind == "scaled"
                    )
                )
            points = libe57.CompressedVectorNode(
                image, row, libe57.VectorNode(image, True)
            )
            if pose:
                scan.set("pose", libe57.StructureNode(image))
            for part, numbers in (pose or {}).items():
                placed = libe57.StructureNode(image)
                scan["pose"].set(part, placed)
                for axis, number in numbers.items():
                    placed.set(axis, libe57.FloatNode(image, number))
            scan.set("points", points)
            file.data3d.append(scan)
            if len(arrays[0]):
                writer = points.writer(buffers)
                writer.write(len(arrays[0]))
                writer.close()


def cartesian(points: FloatArray, kind: str) -> Fields:
    return {f"cartesian{axis}": (kind, points[:, k]) for k, axis in enumerate("XYZ")}


def spherical(points: FloatArray, kind: str) -> Fields:
    x, y, z = points.T
    distance = np.linalg.norm(points, axis=1)
    return {
        "sphericalRange": (kind, distance),
        "sphericalAzimuth": (kind, np.arctan2(y, x)),
        "sphericalElevation": (kind, np.arcsin(z / distance)),
    }


@needs(".e57")
@pytest.mark.parametrize("kind", ["double", "scaled"])
@pytest.mark.parametrize("fields", [cartesian, spherical])
def test_points_of_other_scanners(
    fields: Callable[[FloatArray, str], Fields], kind: str, tmp_path: Path
) -> None:
    """Ranges and angles, scaled integers, readings that are marked as invalid, and scans without points."""
    path, own = tmp_path / "a.e57", fields(POINTS, kind)
    write_fields(path, [own])
    np.testing.assert_allclose(cloud(path).points, POINTS, atol=1e-4)
    states = np.arange(len(POINTS)) % 3
    write_fields(path, [own | {f"{fields.__name__}InvalidState": ("state", states)}])
    np.testing.assert_allclose(cloud(path).points, POINTS[::3], atol=1e-4)
    nothing = fields(POINTS[:0], kind)
    write_fields(path, [nothing, own, nothing, own])
    assert [one.name for one in members_of(path)] == ["a.e57#1", "a.e57#2"]
    np.testing.assert_allclose(cloud(path).points, np.tile(POINTS, (2, 1)), atol=1e-4)
    write_fields(path, [nothing])
    with pytest.raises(ScanReadError, match="the file holds no scans that have points"):
        read_scan(path)


@needs(".e57")
def test_what_else_a_point_of_an_e57_file_has(tmp_path: Path) -> None:
    """Intensities and normals without limits, and coordinates of both kinds, Cartesian ones first."""
    values = POINTS[:, 0]
    names = ("intensity", "timeStamp", "rowIndex", "columnIndex", "nor:normalX")
    others: Fields = {name: ("state", np.ones(len(POINTS))) for name in names}
    wrong = {name: ("double", values) for name in spherical(POINTS, "double")}
    path = tmp_path / "a.e57"
    write_fields(path, [cartesian(POINTS, "scaled") | others | wrong])
    np.testing.assert_allclose(cloud(path).points, POINTS, atol=1e-4)


TRANSLATION = dict(zip("xyz", SENSOR.tolist(), strict=True))
ROTATION = dict(zip("wxyz", QUATERNION.tolist(), strict=True))
WHOLE = {"translation": TRANSLATION, "rotation": ROTATION}


@needs(".e57")
@pytest.mark.parametrize(
    ("pose", "expected"),
    [
        (WHOLE, POINTS @ TURN.as_matrix().T + SENSOR),
        (
            {name: dict(reversed([*part.items()])) for name, part in WHOLE.items()},
            POINTS @ TURN.as_matrix().T + SENSOR,
        ),
        (
            {"rotation": {axis: 3 * value for axis, value in ROTATION.items()}},
            POINTS @ TURN.as_matrix().T,
        ),
        ({"translation": TRANSLATION}, POINTS + SENSOR),
    ],
    ids=["whole", "in another order", "a long quaternion", "a shift"],
)
def test_parts_of_a_pose_of_e57(pose: Pose, expected: FloatArray, tmp_path: Path) -> None:
    """The standard names them, and gives them no order."""
    write_fields(tmp_path / "a.e57", [cartesian(POINTS, "double")], pose)
    np.testing.assert_allclose(cloud(tmp_path / "a.e57").points, expected, atol=1e-9)


@needs(".e57")
def test_stations_of_e57_without_an_answer(tmp_path: Path) -> None:
    """Neither they nor lists that are not there take the points of others with them."""
    path, points = tmp_path / "a.e57", cartesian(POINTS, "double")
    invalid = points | {"cartesianInvalidState": ("state", np.full(len(POINTS), 2))}
    write_fields(path, [invalid, points])
    np.testing.assert_allclose(cloud(path).points, POINTS)
    write_fields(path, [invalid])
    with pytest.raises(ScanReadError, match="this one has none at all"):
        read_scan(path)
    images = path.read_bytes()
    path.write_bytes(
        with_other_xml(images, lambda xml: xml.replace(b"data3D", b"images"))
    )
    with pytest.raises(ScanReadError, match="the file holds no scans that have points"):
        read_scan(path)


HEADS = {
    '<!DOCTYPE e57Root [<!ENTITY a SYSTEM "file:///etc/passwd">]>': "has a document type",
    '<!DOCTYPE e57Root SYSTEM "http://127.0.0.1:{port}/a.dtd">': "has a document type",
    "<?xml version='1.0' encoding='UTF-16'?>": "its XML part is not UTF-8",
    "+ADw-!DOCTYPE": "its XML part is not UTF-8",
}


def with_head(head: bytes, xml: bytes) -> bytes:
    return head + xml[xml.index(b"<e57Root") :]


@needs(".e57")
def test_what_the_xml_of_an_e57_file_refers_to_is_not_opened(tmp_path: Path) -> None:
    path = tmp_path / "a.e57"
    write_e57(path, [{"points": POINTS}])
    whole = path.read_bytes()
    path.write_bytes(with_other_xml(whole, partial(with_head, b"")))
    assert len(cloud(path).points) == len(POINTS)
    with socket.create_server(("127.0.0.1", 0)) as elsewhere:
        for head, words in HEADS.items():
            dtd = head.format(port=elsewhere.getsockname()[1]).encode()
            path.write_bytes(with_other_xml(whole, partial(with_head, dtd)))
            with pytest.raises(ScanReadError, match=words):
                read_scan(path)
        elsewhere.setblocking(False)
        with pytest.raises(BlockingIOError):
            elsewhere.accept()
    path.write_bytes(with_other_xml(whole, lambda xml: xml.decode().encode("utf-16")))
    with pytest.raises(ScanReadError, match="its XML part is not UTF-8"):
        read_scan(path)


# --- packages that are missing ----------------------------------------------------------------------------

WITHOUT = """
import sys
from functools import partial
from pathlib import Path

class Missing:
    def find_spec(self, name, path=None, target=None):
        if name in ("pye57", "lazrs", "lxml"):
            raise ModuleNotFoundError(name)

sys.meta_path.insert(0, Missing())
import importlib.util

found = importlib.util.find_spec
importlib.util.find_spec = lambda name: None if name in ("pye57", "lazrs", "lxml") else found(name)
from pcretrieve import read_scan
from pcretrieve.errors import ScanReadError
from pcretrieve.formats import ScanPath, is_scan
from pcretrieve.ingestion.discover import unread_files

paths = [Path(name) for name in ("a.e57", "b.e57", "c.laz", "d.3mf", "e.jpg")]
print(unread_files(paths), [is_scan(ScanPath(path)) for path in paths])
try:
    read_scan("a.e57")
except ScanReadError as error:
    print(error.message)
"""


def test_an_extra_that_is_missing_is_named(tmp_path: Path) -> None:
    run = subprocess.run(
        [sys.executable, "-c", WITHOUT],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    unread, message = run.stdout.splitlines()
    assert unread == (
        "2 .e57 (pip install 'pcretrieve[e57]'), 1 .3mf (pip install 'pcretrieve[meshes]'), "
        "1 .laz (pip install 'pcretrieve[las]'), 1 .jpg [False, False, False, False, False]"
    )
    assert (
        message
        == "a.e57: reading .e57 needs the package pye57: pip install 'pcretrieve[e57]'"
    )


# --- views ----------------------------------------------------------------------------------------------


def test_views_are_merged_by_their_poses_sensors_included(tmp_path: Path) -> None:
    sensor = np.array([0.0, 0.0, 5.0])
    motions = []
    for view, angle in enumerate((0.0, 0.7)):
        motion = np.eye(4)
        motion[:3, :3] = Rotation.from_rotvec([0, angle, 0]).as_matrix()
        motion[:3, 3] = [view, 0, 0]
        back = np.linalg.inv(motion)
        write_pcd(
            tmp_path / f"v{view}.pcd",
            POINTS @ back[:3, :3].T + back[:3, 3],
            back[:3, :3] @ sensor + back[:3, 3],
            Rotation.identity(),
        )
        motions.append(motion)
    write_conf(tmp_path / "both.conf", ["v0.pcd", "v1.pcd"], np.array(motions))
    found = read_scan(tmp_path / "both.conf")
    assert isinstance(found, PointCloud)
    np.testing.assert_allclose(
        found.points, np.concatenate([POINTS, POINTS]), atol=10 * SINGLE
    )
    assert found.viewpoints is not None
    np.testing.assert_allclose(
        found.viewpoints, np.tile(sensor, (2 * len(POINTS), 1)), atol=10 * SINGLE
    )
    first, second = parts_of(tmp_path / "both.conf")
    assert (first.path, second.path) == (tmp_path / "v0.pcd", tmp_path / "v1.pcd")
    for part, motion in zip((first, second), motions, strict=True):
        assert part.pose is not None
        np.testing.assert_allclose(part.pose, motion, atol=1e-6)
