"""Points that were written, with normals and sensor positions, are read again unchanged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapes

from pcretrieve import PointCloud, read_scan
from pcretrieve.errors import InputError
from pcretrieve.formats import write_cloud

POINTS = shapes.points_on(shapes.icosphere(3), 200)
NORMALS = POINTS / np.linalg.norm(POINTS, axis=1, keepdims=True)
CLOUD = PointCloud(POINTS, NORMALS, 3 * NORMALS)


@pytest.mark.parametrize(("suffix", "error"), [(".ply", 0.0), (".pcd", 1e-6), (".xyzn", 1e-8)])
def test_what_is_written_is_read(suffix: str, error: float, tmp_path: Path) -> None:
    write_cloud(CLOUD, tmp_path / f"ball{suffix}")
    found = read_scan(tmp_path / f"ball{suffix}")
    assert isinstance(found, PointCloud)
    assert found.normals is not None
    np.testing.assert_allclose(found.points, POINTS, rtol=0, atol=error)
    np.testing.assert_allclose(found.normals, NORMALS, rtol=0, atol=max(error, 1e-12))
    if suffix == ".xyzn":
        assert found.viewpoints is None
    else:
        assert found.viewpoints is not None
        np.testing.assert_allclose(found.viewpoints, 3 * NORMALS, rtol=0, atol=3 * error)


@pytest.mark.parametrize("suffix", [".ply", ".pcd"])
def test_points_alone(suffix: str, tmp_path: Path) -> None:
    write_cloud(PointCloud(POINTS), tmp_path / f"ball{suffix}")
    found = read_scan(tmp_path / f"ball{suffix}")
    assert isinstance(found, PointCloud)
    assert found.normals is None and found.viewpoints is None


@pytest.mark.parametrize(
    ("cloud", "name", "words"),
    [
        (CLOUD, "ball.obj", r"\.ply \.pcd \.xyzn, got ball\.obj"),
        (PointCloud(POINTS), "ball.xyzn", "must hold normals"),
        (CLOUD, "nowhere/ball.ply", "cannot write"),
        (CLOUD, "folder.ply", "cannot write"),
    ],
)
def test_what_cannot_be_written_leaves_nothing(
    cloud: PointCloud, name: str, words: str, tmp_path: Path
) -> None:
    (tmp_path / "folder.ply").mkdir()
    with pytest.raises(InputError, match=words):
        write_cloud(cloud, tmp_path / name)
    assert [path.name for path in tmp_path.iterdir()] == ["folder.ply"]


def test_a_file_is_replaced_and_readable_by_all_who_may(tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.touch()
    (tmp_path / "ball.ply").write_text("old")
    write_cloud(CLOUD, tmp_path / "ball.ply")
    assert (tmp_path / "ball.ply").stat().st_mode == other.stat().st_mode
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ball.ply", "other"]
