"""Every format: a scan that was written is read again unchanged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapes
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from pcretrieve import PointCloud, TriangleMesh, read_scan
from pcretrieve.errors import ScanReadError
from pcretrieve.formats import write_mesh
from pcretrieve.simulation import write_conf, write_pcd, write_ply

DATA = Path(__file__).parents[2].parent / "shared" / "data"
POINTS = shapes.points_on(shapes.ellipsoid(), 500)
# Single precision, relative to coordinates of about 1.
SINGLE = 1e-6


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".off", ".stl", ".glb"])
def test_meshes(suffix: str, tmp_path: Path) -> None:
    mesh = shapes.ellipsoid(subdivisions=2)
    write_mesh(mesh, tmp_path / f"egg{suffix}")
    found = read_scan(tmp_path / f"egg{suffix}")
    assert isinstance(found, TriangleMesh)
    assert (len(found.vertices), len(found.faces)) == (len(mesh.vertices), len(mesh.faces))
    assert found.volume == pytest.approx(mesh.volume, rel=1e-5)


@pytest.mark.parametrize(
    ("name", "line"),
    [("a.xyz", "{} {} {}"), ("b.xyz", "{},{},{}"), ("c.xyzn", "{} {} {} 0 0 2"), ("d.pts", "{} {} {} 1 2 3")],
)
def test_points_as_text(name: str, line: str, tmp_path: Path) -> None:
    lines = [line.format(*point) for point in POINTS]
    if name.endswith(".pts"):
        lines.insert(0, str(len(POINTS)))
    (tmp_path / name).write_text("\n".join(lines))  # no line feed at the end
    found = read_scan(tmp_path / name)
    assert isinstance(found, PointCloud)
    np.testing.assert_array_equal(found.points, POINTS)
    if name.endswith(".xyzn"):
        np.testing.assert_array_equal(found.normals, np.tile([0.0, 0.0, 1.0], (len(POINTS), 1)))


def test_a_pts_file_must_hold_what_its_first_line_promises(tmp_path: Path) -> None:
    (tmp_path / "short.pts").write_text("3\n1 2 3\n4 5 6\n")
    with pytest.raises(ScanReadError, match="declares 3 points"):
        read_scan(tmp_path / "short.pts")


def test_ply_points(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", POINTS)
    found = read_scan(tmp_path / "a.ply")
    assert isinstance(found, PointCloud)
    np.testing.assert_allclose(found.points, POINTS, atol=SINGLE)
    assert found.viewpoints is None


def test_pcd_points_with_their_sensor(tmp_path: Path) -> None:
    write_pcd(tmp_path / "a.pcd", POINTS, np.array([1.0, 2.0, 3.0]), Rotation.identity())
    found = read_scan(tmp_path / "a.pcd")
    assert isinstance(found, PointCloud)
    np.testing.assert_allclose(found.points, POINTS, atol=SINGLE)
    assert found.viewpoints is not None
    np.testing.assert_allclose(found.viewpoints, np.tile([1.0, 2.0, 3.0], (len(POINTS), 1)))


def test_a_pcd_sensor_at_the_default_is_no_sensor(tmp_path: Path) -> None:
    write_pcd(tmp_path / "a.pcd", POINTS, np.zeros(3), Rotation.identity())
    found = read_scan(tmp_path / "a.pcd")
    assert isinstance(found, PointCloud)
    assert found.viewpoints is None


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
    np.testing.assert_allclose(found.points, np.concatenate([POINTS, POINTS]), atol=10 * SINGLE)
    assert found.viewpoints is not None
    np.testing.assert_allclose(found.viewpoints, np.tile(sensor, (2 * len(POINTS), 1)), atol=10 * SINGLE)


@pytest.mark.parametrize("line", ["bmesh missing.ply 0 0 0 0 0 0 1", "bmesh a.ply 0 0 0 1", "camera 0 0 0"])
def test_a_conf_that_cannot_be_followed(line: str, tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", POINTS)
    (tmp_path / "bad.conf").write_text(f"{line}\n")
    with pytest.raises(ScanReadError, match=r"bad\.conf"):
        read_scan(tmp_path / "bad.conf")


@pytest.mark.skipif(
    not DATA.is_dir(), reason="needs the Stanford dragon beside the checkout, in ../shared/data"
)
def test_the_views_of_the_dragon_meet() -> None:
    """Neighbouring views overlap: a point of one has one of the other within a third of a millimetre."""
    found = read_scan(DATA / "stanford_dragon" / "dragonStandRight.conf")
    assert isinstance(found, PointCloud)
    assert len(found.points) == 469_193
    first, second = found.points[:41_841], found.points[41_841 : 41_841 + 34_436]
    gap, _ = cKDTree(second).query(first)
    assert np.quantile(gap, 0.25) < 3e-4
