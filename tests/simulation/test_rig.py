"""Laws of the virtual scanners, on a ball of radius 1, whose diagonal is 2√3; and the sample set."""

from __future__ import annotations

import csv
import re
from collections import Counter
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapes
from benchmarks.poses import POSES, SUBJECTS
from benchmarks.samples import write, write_views
from benchmarks.simulation import (
    RigOptions,
    body,
    camera_pose,
    make_subject,
    scan,
    scan_views,
)
from benchmarks.simulation.samples import random_motion, write_samples
from benchmarks.simulation.skeleton import Bone, Pose, RoundCone, Subject
from benchmarks.turning import TurningOptions, turning_frames, write_frames
from benchmarks.uniform import UniformOptions, scan_uniformly
from scipy.spatial.transform import Rotation

from pcretrieve import read_scan
from pcretrieve.arrays.open3d import RayScene
from pcretrieve.formats.conf import read_poses
from pcretrieve.formats.ply import read_ply
from pcretrieve.pipeline.registration.alignment import moved
from pcretrieve.values import FloatArray, PointCloud, TriangleMesh

# The ball is made of flat faces whose middles lie at most this much below it.
SAG = 1.5e-3


def perfect(**changed: Any) -> RigOptions:
    exact = RigOptions(
        noise=0.0,
        flying_share=0.0,
        n_holes=0,
        outlier_share=0.0,
        n_points=None,
        pixels=80,
        max_incidence=75,
    )
    return replace(exact, **changed)


def uniform(
    n_points: int, mesh: TriangleMesh | None = None, seed: int = 0, **changed: Any
) -> PointCloud:
    exact = UniformOptions(n_points=n_points, noise=0, n_holes=0, outlier_share=0)
    return scan_uniformly(mesh or ball(), replace(exact, **changed), rng(seed))


@cache
def ball() -> TriangleMesh:
    flesh = RoundCone((0, 0, 0), (0, 0, 0), (1, 1))
    bone = Bone("ball", None, (0, 0, 0), (0, 0.1, 0), (0, 0, 1), (flesh,), "ball")
    return body(Subject("ball", (bone,), cell=0.06), Pose())


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def rays(cloud: PointCloud) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Unit direction from the sensor to each point, distance on, and distance to the unit ball that way."""
    assert cloud.viewpoints is not None
    offset = cloud.points - cloud.viewpoints
    distance = np.linalg.norm(offset, axis=1)
    direction = offset / distance[:, None]
    along = -np.einsum("ij,ij->i", cloud.viewpoints, direction)
    missing = (cloud.viewpoints**2).sum(axis=1) - along**2
    return direction, distance, along - np.sqrt(np.maximum(1 - missing, 0))


def test_a_perfect_scanner_sees_the_surface_from_its_cameras() -> None:
    options = perfect(max_incidence=70)
    views = scan_views(ball(), options, rng())
    assert len(views) == options.n_views
    for number, view in enumerate(views):
        assert view.viewpoints is not None
        camera = camera_pose(ball(), options, number)
        assert np.allclose(view.viewpoints, camera[:3, 3])
        assert np.linalg.norm(camera[:3, 3]) == pytest.approx(
            options.distance * ball().diagonal, rel=1e-3
        )
        assert np.abs(np.linalg.norm(view.points, axis=1) - 1).max() < SAG
        cosine = -np.einsum("ij,ij->i", rays(view)[0], view.points)
        # Normals of faces and of the ball differ by half an edge.
        assert cosine.min() > np.cos(np.radians(70)) - 0.05
        assert cosine.max() > 0.998


def test_noise_has_its_size_along_the_ray_and_grows_with_incidence() -> None:
    noise = 0.004
    direction, distance, true = rays(
        scan(ball(), perfect(noise=noise, pixels=200), rng())
    )
    # Same pixels, in the same order.
    normals = scan(ball(), perfect(pixels=200), rng()).points
    cosine = -np.einsum("ij,ij->i", direction, normals)
    error = (distance - true) / (noise * ball().diagonal)
    for low, high in ((0.97, 1.0), (0.45, 0.55)):
        band = (cosine > low) & (cosine < high)
        expected = np.sqrt((cosine[band] ** -2).mean())
        assert error[band].std() == pytest.approx(expected, rel=0.1)


def test_flying_pixels_lie_behind_edges_within_reach() -> None:
    options = perfect(flying_share=1.0, flying_reach=0.03, max_incidence=90)
    _, distance, true = rays(scan(ball(), options, rng()))
    behind = distance - true
    flying = behind > 0.01 * ball().diagonal
    assert 0 < flying.sum() < 0.2 * len(behind)
    # At the very rim, flat faces lie in front of the ball by more than their sag.
    assert behind.max() < (0.03 + 0.01) * ball().diagonal


# --- uniform scans ------------------------------------------------------------------------------------


def test_uniform_points_are_uniform_and_holes_stay_empty() -> None:
    n, radius = 40_000, 0.1
    points = uniform(n).points
    assert points.mean(axis=0) == pytest.approx([0, 0, 0], abs=0.015)
    assert points.T @ points / n == pytest.approx(np.eye(3) / 3, abs=0.01)
    # A ball whose centre lies on the unit sphere cuts a cap of area π r² out of it, wherever it lies.
    share = (radius * ball().diagonal) ** 2 / 4
    for seed in range(3):
        missing = n - len(uniform(n, seed=seed, n_holes=1, hole_radius=radius).points)
        assert missing == pytest.approx(n * share, abs=4 * np.sqrt(n * share))


def test_sensors_of_uniform_scans_see_their_points() -> None:
    cloud, blind = (
        uniform(5_000, outlier_share=0.1, sensors=sensors) for sensors in (True, False)
    )
    assert np.array_equal(cloud.points, blind.points), "a ball hides nothing"
    assert cloud.viewpoints is not None
    reach = RigOptions().distance * ball().diagonal
    assert np.linalg.norm(cloud.viewpoints, axis=1) == pytest.approx(reach, rel=1e-3)
    direction, distance, true = (part[:5_000] for part in rays(cloud))
    # Rays that graze the ball meet its flat faces far from where they meet the ball itself.
    cosine = -np.einsum("ij,ij->i", direction, cloud.points[:5_000])
    assert cosine.min() > np.cos(np.radians(RigOptions().max_incidence)) - 0.05
    assert np.abs(distance - true)[cosine > 0.5].max() < 2 * SAG


# --- a depth camera before a turning body -------------------------------------------------------------

EXACT = TurningOptions(
    n_frames=3, turn=90.0, width=60, height=80, focal=85.0, noise=0.0, flying_share=0.0
)


def test_without_noise_every_point_is_on_the_body_the_floor_or_the_wall(
    tmp_path: Path,
) -> None:
    mesh = shapes.icosphere(4, radius=0.6)
    images, motions = turning_frames(mesh, EXACT, rng())
    files = write_frames(tmp_path, images, EXACT)
    assert [file.name for file in files] == [
        "frame000.png",
        "frame001.png",
        "frame002.png",
    ]
    tilt = np.radians(EXACT.tilt)
    down, ahead = (
        np.array([0, np.cos(tilt), np.sin(tilt)]),
        np.array([0, -np.sin(tilt), np.cos(tilt)]),
    )
    for file, motion in zip(files, motions, strict=True):
        frame = read_scan(file)
        assert isinstance(frame, PointCloud)
        on_body = (
            RayScene(moved(motion, mesh.vertices), mesh.faces).distance(frame.points)
            < 0.002
        )
        on_floor = abs(frame.points @ down - EXACT.camera_height) < 0.002
        on_wall = abs(frame.points @ ahead - EXACT.wall) < 0.002
        assert (on_body | on_floor | on_wall).all()
        assert min(on_body.mean(), on_floor.mean(), on_wall.mean()) > 0.05


# --- the sample set -----------------------------------------------------------------------------------

SCANS = Path(__file__).parents[2] / "scans"


def test_the_same_seed_makes_the_same_bytes_and_the_points_of_the_set(
    tmp_path: Path,
) -> None:
    bodies, files = {}, []

    def kept(
        path: Path, surface: TriangleMesh, placed: FloatArray, rng: np.random.Generator
    ) -> Path:
        bodies[path.name] = RayScene(moved(placed, surface.vertices), surface.faces)
        return write(path, surface, placed, rng)

    for run in ("one", "two"):
        labels = write_samples(
            tmp_path / run,
            ["hand-2_fan", "hand-1_open"],
            subjects=SUBJECTS,
            poses=POSES,
            write=kept,
        )
        assert labels == {
            "hand-1/hand-1_open.ply": "hand-1",
            "hand-2/hand-2_fan.conf": "hand-2",
        }
        made = (tmp_path / run).rglob("*.*")
        files.append(
            {file.relative_to(tmp_path / run): file.read_bytes() for file in made}
        )
    assert len(files[0]) == 2 + RigOptions().n_views + 1
    assert files[0] == files[1]
    # Points differ by processor and version; those of the set are on the same bodies, by the noise.
    cloud = PointCloud(read_ply(SCANS / "hand-1" / "hand-1_open.ply").points)
    assert (
        np.median(abs(bodies["hand-1_open"].distance(cloud.points)))
        < RigOptions().noise * cloud.diagonal
    )


def test_views_lie_on_the_body_and_sensors_where_they_stood(tmp_path: Path) -> None:
    chance = rng(4)
    surface = body(make_subject("hand", chance), POSES["hand"]["spread"])
    placed = random_motion(chance)
    conf = write_views(tmp_path / "hand_spread", surface, placed, chance)
    scene, rig = RayScene(surface.vertices, surface.faces), RigOptions()
    whole, back = read_scan(conf), np.linalg.inv(placed).astype(np.float64)
    assert isinstance(whole, PointCloud) and whole.viewpoints is not None
    off = scene.distance(moved(back, whole.points)) / surface.diagonal
    assert np.quantile(off, 0.95) < 4 * rig.noise
    cameras = np.array(
        [camera_pose(surface, rig, number)[:3, 3] for number in range(rig.n_views)]
    )
    apart = np.linalg.norm(
        moved(back, whole.viewpoints)[:, None] - cameras, axis=2
    )  # (n, v)
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
    views = {
        view
        for file in files
        if file.suffix == ".conf"
        for view, _, _ in read_poses(file)
    }
    assert all(file.is_file() for file in files | views)
    strange = {file for file in SCANS.rglob("*.*") if file.is_file()} - files - views
    assert strange == {SCANS / "labels.csv", SCANS / "README.md"}
    assert sum(file.stat().st_size for file in SCANS.rglob("*") if file.is_file()) < 9e6
