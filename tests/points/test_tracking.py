"""Frames of a depth camera before a turning body: registered in their order, without poses."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import shapes

import pcretrieve
from pcretrieve import PointCloud, TriangleMesh
from pcretrieve.draw.open3d import RayScene
from pcretrieve.options import PipelineOptions
from pcretrieve.points.register import merge_views
from pcretrieve.points.register.alignment import moved
from pcretrieve.simulation.turning import TurningOptions, turning_frames, write_frames
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


@pytest.mark.slow
def test_a_turn_before_a_camera_becomes_one_cloud_without_its_background(tmp_path: Path) -> None:
    images, motions = sequence()
    write_frames(tmp_path, images, CAMERA)
    merged = pcretrieve.merge_views(tmp_path, "depth-camera")
    assert merged.left_out == ()
    (step,) = merged.cloud.provenance
    (note,) = step.notes
    n_keys = int(note.split()[-3])
    assert note == f"registered 30 views of a sequence by {n_keys} key frames" and 5 < n_keys < 30
    truth = motions[0] @ np.linalg.inv(motions)
    corners = body().vertices[::50]
    off = [
        np.linalg.norm(moved(pose @ motion, corners) - moved(true @ motion, corners), axis=1).max()
        for pose, true, motion in zip(merged.poses, truth, motions, strict=True)
    ]
    assert max(off) < 0.01 * body().diagonal
    assert merged.rms() < 0.003 * merged.scale
    surface = RayScene(moved(motions[0], body().vertices), body().faces)
    # The floor reaches the soles, and noise is not bounded.
    assert np.quantile(surface.distance(merged.cloud.points), 0.999) < 0.02 * body().diagonal


def test_a_foreign_frame_does_not_end_the_sequence() -> None:
    images, _ = sequence()
    strange, _ = turning_frames(shapes.torus(major=0.6), CAMERA, np.random.default_rng(1))
    frames = [as_points(image) for image in (*images[:2], strange[0], images[3])]
    found = merge_views(frames, DEPTH_CAMERA)
    assert found.left_out == (2,)
    (step,) = found.cloud.provenance
    assert any("left out view 2" in note for note in step.notes)


def as_points(image: FloatArray) -> PointCloud:
    """The points of a depth image, with the camera at the origin."""
    v, u = np.nonzero(image)
    z = image[v, u]
    x = (u - (CAMERA.width - 1) / 2) * z / CAMERA.focal
    y = (v - (CAMERA.height - 1) / 2) * z / CAMERA.focal
    return PointCloud(np.column_stack([x, y, z]))
