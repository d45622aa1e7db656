"""The sample set: made by a seed, and what its files say is where things are."""

from __future__ import annotations

import csv
import re
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from benchmarks.samples import write, write_views
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from pcretrieve import PointCloud, read_scan
from pcretrieve.draw.open3d import RayScene
from pcretrieve.formats.conf import read_poses
from pcretrieve.formats.ply import read_ply
from pcretrieve.simulation import POSES, RigOptions, body, camera_pose, make_subject
from pcretrieve.simulation.samples import moved, random_motion, write_samples

ROOT = Path(__file__).parents[2]
SCANS = ROOT / "scans"


def test_the_same_seed_makes_the_same_bytes_and_the_points_of_the_set(tmp_path: Path) -> None:
    for run in ("one", "two"):
        labels = write_samples(tmp_path / run, ["hand-2_fan", "hand-1_open"], write=write)
        assert labels == {"hand-1/hand-1_open.ply": "hand-1", "hand-2/hand-2_fan.conf": "hand-2"}
    one, two = (
        {file.relative_to(tmp_path / run): file.read_bytes() for file in (tmp_path / run).rglob("*.*")}
        for run in ("one", "two")
    )
    assert len(one) == 2 + RigOptions().n_views + 1
    assert one == two
    # Bytes differ from processor to processor, in the last digits; the points are those of the set.
    name = "hand-1/hand-1_open.ply"
    made, kept = (read_ply(folder / name).points for folder in (tmp_path / "one", SCANS))
    gap, _ = cKDTree(made).query(kept)
    assert np.median(gap) < 1e-3 * np.linalg.norm(np.ptp(kept, axis=0))


def test_views_lie_on_the_body_and_sensors_where_they_stood(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    surface = body(make_subject("hand", rng), POSES["hand"]["spread"])
    placed = random_motion(rng)
    conf = write_views(tmp_path / "hand_spread", surface, placed, rng)
    scene, rig = RayScene(surface.vertices, surface.faces), RigOptions()
    whole, back = read_scan(conf), np.linalg.inv(placed).astype(np.float64)
    assert isinstance(whole, PointCloud) and whole.viewpoints is not None
    off = scene.distance(moved(back, whole.points)) / surface.diagonal
    assert np.quantile(off, 0.95) < 4 * rig.noise
    cameras = np.array([camera_pose(surface, rig, number)[:3, 3] for number in range(rig.n_views)])
    apart = np.linalg.norm(moved(back, whole.viewpoints)[:, None] - cameras, axis=2)  # (n, v)
    assert apart.min(axis=1) == pytest.approx(0, abs=1e-6)
    assert (np.diff(apart.argmin(axis=1)) >= 0).all(), "view by view"
    views = read_poses(conf)
    assert len(views) == rig.n_views
    for path, _, _ in views:
        said = re.search(rb"VIEWPOINT (.*)\n", path.read_bytes())
        assert said is not None
        pose = np.array(said[1].split(), dtype=np.float64)  # tx ty tz qw qx qy qz
        # The sensor looks along its own z axis, which the quaternion turns into the frame of the points.
        ahead = Rotation.from_quat(pose[[4, 5, 6, 3]]).apply([0, 0, 1])
        seen = read_scan(path)
        assert isinstance(seen, PointCloud)
        towards = np.median(seen.points, axis=0) - pose[:3]
        assert ahead @ towards / np.linalg.norm(towards) > 0.9
    assert max(rotation.magnitude() for _, rotation, _ in views) > 0.1


def test_the_sample_set_is_whole_and_small() -> None:
    with (SCANS / "labels.csv").open(newline="", encoding="utf-8") as file:
        labels = list(csv.DictReader(file))
    assert list(Counter(row["class"] for row in labels).values()) == [5] * 8
    files = {SCANS / row["file"] for row in labels}
    views = {view for file in files if file.suffix == ".conf" for view, _, _ in read_poses(file)}
    assert all(file.is_file() for file in files | views)
    strange = {file for file in SCANS.rglob("*.*") if file.is_file()} - files - views
    assert strange == {SCANS / "labels.csv", SCANS / "README.md"}
    assert sum(file.stat().st_size for file in SCANS.rglob("*") if file.is_file()) < 9e6
