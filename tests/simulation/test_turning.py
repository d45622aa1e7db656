"""Depth images of a turning body: where their points are, and what is in the files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapes

from pcretrieve import PointCloud, read_scan
from pcretrieve.draw.open3d import RayScene
from pcretrieve.points.register.alignment import moved
from pcretrieve.simulation.turning import TurningOptions, turning_frames, write_frames

EXACT = TurningOptions(n_frames=3, turn=90.0, width=60, height=80, focal=85.0, noise=0.0, flying_share=0.0)


def test_without_noise_every_point_is_on_the_body_the_floor_or_the_wall(tmp_path: Path) -> None:
    ball = shapes.icosphere(4)
    mesh = replace(ball, vertices=0.6 * ball.vertices)
    images, motions = turning_frames(mesh, EXACT, np.random.default_rng(0))
    files = write_frames(tmp_path, images, EXACT)
    assert [file.name for file in files] == ["frame000.png", "frame001.png", "frame002.png"]
    tilt = np.radians(EXACT.tilt)
    down, ahead = np.array([0, np.cos(tilt), np.sin(tilt)]), np.array([0, -np.sin(tilt), np.cos(tilt)])
    for file, motion in zip(files, motions, strict=True):
        scan = read_scan(file)
        assert isinstance(scan, PointCloud)
        on_body = RayScene(moved(motion, mesh.vertices), mesh.faces).distance(scan.points) < 0.002
        on_floor = abs(scan.points @ down - EXACT.camera_height) < 0.002
        on_wall = abs(scan.points @ ahead - EXACT.wall) < 0.002
        assert (on_body | on_floor | on_wall).all()
        assert min(on_body.mean(), on_floor.mean(), on_wall.mean()) > 0.05


def test_the_body_stands_on_the_floor_and_turns_about_a_vertical_axis() -> None:
    mesh = shapes.icosphere(2)
    _, motions = turning_frames(mesh, replace(EXACT, unevenness=0.0), np.random.default_rng(0))
    step = motions[1] @ np.linalg.inv(motions[0])
    assert np.degrees(np.arccos((np.trace(step[:3, :3]) - 1) / 2)) == pytest.approx(30)
    up = motions[0][:3, 1]
    np.testing.assert_allclose(step[:3, :3] @ up, up, atol=1e-12)
    np.testing.assert_allclose(motions[:, :3, 1], np.tile(up, (3, 1)), atol=1e-12)
    assert (moved(motions[2], mesh.vertices) @ up).min() == pytest.approx(-EXACT.camera_height)
