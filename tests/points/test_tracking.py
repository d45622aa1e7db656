"""Frames of a depth camera before a turning body: registered in their order, without poses."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import shapes
from benchmarks.turning import TurningOptions, turning_frames, write_frames

import pcretrieve
from pcretrieve import PointCloud, TriangleMesh
from pcretrieve.draw.open3d import RayScene
from pcretrieve.options import MergeOptions, PipelineOptions
from pcretrieve.points.register import Merged, merge_views
from pcretrieve.points.register.alignment import moved
from pcretrieve.points.register.tracking import tracks
from pcretrieve.points.register.views import foreground, prepared
from pcretrieve.simulation import RigOptions, scan_views
from pcretrieve.values import FloatArray

CAMERA = TurningOptions(n_frames=30, width=120, height=160, focal=170.0)
DEPTH_CAMERA = PipelineOptions.preset("depth-camera").merge


@cache
def body() -> TriangleMesh:
    """A body of the height of a person; m."""
    mesh = shapes.body()
    return replace(mesh, vertices=1.7 * mesh.vertices / np.ptp(mesh.vertices[:, 1]))


@cache
def sequence() -> tuple[FloatArray, FloatArray]:
    return turning_frames(body(), CAMERA, np.random.default_rng(0))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("frames")
    write_frames(place, sequence()[0], CAMERA)
    return place


@pytest.fixture(scope="module")
def merged(folder: Path) -> Merged:
    return pcretrieve.merge_views(folder, "depth-camera")


def test_a_turn_before_a_camera_becomes_one_cloud_without_its_background(merged: Merged) -> None:
    _, motions = sequence()
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


def test_a_noisy_wall_is_background() -> None:
    """The noise grows with the square of the range: that of the wall is 3 cm here, that of the body 1 cm."""
    noisy = replace(CAMERA, n_frames=4, noise=0.006)
    thin = replace(body(), vertices=body().vertices * [0.4, 1, 0.4])
    images, motions = turning_frames(thin, noisy, np.random.default_rng(3))
    for image, motion in zip(images, motions, strict=True):
        points = as_points(image).points
        front = foreground(PointCloud(points), np.zeros(3), 0, DEPTH_CAMERA)
        surface = RayScene(moved(motion, thin.vertices), thin.faces)
        assert np.quantile(surface.distance(front), 0.99) < 0.05 * thin.diagonal
        depth, _, _ = surface.cast(np.zeros_like(points), points)
        assert len(front) > 0.9 * np.isfinite(depth).sum()


def test_the_loop_is_closed(merged: Merged) -> None:
    """The last frames overlap the first ones again, where errors of a chain of frames would add up."""
    closing = [pair for pair in merged.overlaps if pair.first < 5 and pair.second >= 25]
    assert closing and max(pair.share for pair in closing) > 0.7


def test_a_foreign_frame_does_not_end_the_sequence() -> None:
    images, _ = sequence()
    strange, _ = turning_frames(shapes.torus(major=0.6), CAMERA, np.random.default_rng(1))
    frames = [as_points(image) for image in (*images[:3], strange[0], *images[4:6])]
    found = merge_views(frames, DEPTH_CAMERA)
    assert found.left_out == (3,)
    (step,) = found.cloud.provenance
    assert any("left out view 3" in note for note in step.notes)


def test_a_body_that_stands_still_has_one_key_frame() -> None:
    still = replace(CAMERA, n_frames=4, turn=0.0)
    images, _ = turning_frames(body(), still, np.random.default_rng(2))
    views, scale = prepared([as_points(image) for image in images], DEPTH_CAMERA, np.random.default_rng(0))
    (track,) = tracks(views, scale, DEPTH_CAMERA)
    assert list(track.key_poses) == [0] and list(track.poses) == [0, 1, 2, 3]


def test_key_frames_of_given_poses_are_registered_first() -> None:
    images, motions = sequence()
    frames = [as_points(image) for image in images[:8]]
    truth = np.linalg.inv(motions[:8]).astype(np.float64)
    found = merge_views(frames, DEPTH_CAMERA, poses=truth)
    assert found.left_out == ()
    (step,) = found.cloud.provenance
    (note,) = step.notes
    assert note.startswith("registered 8 views of a sequence by ") and int(note.split()[-3]) < 8
    corners = body().vertices[::50]
    there = [moved(pose @ motion, corners) for pose, motion in zip(found.poses, motions, strict=False)]
    assert max(np.linalg.norm(place - corners, axis=1).max() for place in there) < 0.01 * body().diagonal


def test_views_in_no_order_are_alone() -> None:
    rig = RigOptions(n_views=4, pixels=80, n_points=None)
    options = MergeOptions()
    clouds = scan_views(shapes.body(), rig, np.random.default_rng(0))
    apart = []
    for cloud, first in zip(clouds, (0, 1, 2, 1), strict=True):
        axes = np.roll(np.eye(3), first, axis=0)
        assert cloud.viewpoints is not None
        apart.append(PointCloud(cloud.points @ axes.T, viewpoints=cloud.viewpoints @ axes.T))
    views, scale = prepared(apart, options, np.random.default_rng(0))
    assert [len(track.poses) for track in tracks(views, scale, options)] == [1, 1, 1, 1]


def as_points(image: FloatArray) -> PointCloud:
    """The points of a depth image, with the camera at the origin."""
    v, u = np.nonzero(image)
    z = image[v, u]
    x = (u - (CAMERA.width - 1) / 2) * z / CAMERA.focal
    y = (v - (CAMERA.height - 1) / 2) * z / CAMERA.focal
    return PointCloud(np.column_stack([x, y, z]))
