"""Laws of the virtual scanner, on a ball of radius 1: its diagonal is 2√3."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from benchmarks.uniform import UniformOptions, scan_uniformly

from pcretrieve.simulation import RigOptions, body, camera_pose, scan, scan_views
from pcretrieve.simulation.skeleton import Bone, Pose, RoundCone, Subject
from pcretrieve.values import FloatArray, PointCloud, TriangleMesh

# The ball is made of flat faces whose middles lie at most this much below it.
SAG = 1.5e-3

PERFECT: dict[str, Any] = {
    "noise": 0.0,
    "flying_share": 0.0,
    "n_holes": 0,
    "outlier_share": 0.0,
    "n_points": None,
    "pixels": 80,
}


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
    options = RigOptions(**PERFECT, max_incidence=70)
    views = scan_views(ball(), options, rng())
    assert len(views) == options.n_views
    for number, view in enumerate(views):
        assert view.viewpoints is not None
        camera = camera_pose(ball(), options, number)
        assert np.allclose(view.viewpoints, camera[:3, 3])
        assert np.linalg.norm(camera[:3, 3]) == pytest.approx(options.distance * ball().diagonal, rel=1e-3)
        assert np.abs(np.linalg.norm(view.points, axis=1) - 1).max() < SAG
        cosine = -np.einsum("ij,ij->i", rays(view)[0], view.points)
        # Normals of faces and of the ball differ by half an edge.
        assert cosine.min() > np.cos(np.radians(70)) - 0.05
        assert cosine.max() > 0.998


def test_noise_has_its_size_along_the_ray_and_grows_with_incidence() -> None:
    noise = 0.004
    options = RigOptions(**PERFECT | {"noise": noise, "pixels": 200}, max_incidence=75)
    direction, distance, true = rays(scan(ball(), options, rng()))
    cloud_normal = scan(ball(), RigOptions(**PERFECT | {"pixels": 200}, max_incidence=75), rng()).points
    cosine = -np.einsum("ij,ij->i", direction, cloud_normal)  # same pixels, in the same order
    error = (distance - true) / (noise * ball().diagonal)
    for low, high in ((0.97, 1.0), (0.45, 0.55)):
        band = (cosine > low) & (cosine < high)
        expected = np.sqrt((cosine[band] ** -2).mean())
        assert error[band].std() == pytest.approx(expected, rel=0.1)


def test_flying_pixels_lie_behind_edges_within_reach() -> None:
    reach = 0.03
    settings = PERFECT | {"flying_share": 1.0}
    options = RigOptions(**settings, flying_reach=reach, max_incidence=90)
    _, distance, true = rays(scan(ball(), options, rng()))
    behind = distance - true
    flying = behind > 0.01 * ball().diagonal
    assert 0 < flying.sum() < 0.2 * len(behind)
    # At the very rim, flat faces lie in front of the ball by more than their sag.
    assert behind.max() < (reach + 0.01) * ball().diagonal


def test_outliers_are_as_many_as_asked_for_and_stay_in_their_box() -> None:
    options = RigOptions(**PERFECT | {"n_points": 5_000, "outlier_share": 0.1})
    points = scan(ball(), options, rng()).points
    off = np.abs(np.linalg.norm(points, axis=1) - 1) > SAG
    assert len(points) == pytest.approx(5_500, abs=options.n_views)
    assert off.sum() == pytest.approx(500, abs=options.n_views)
    assert np.abs(points[off]).max() < 1.2 + SAG
    assert np.abs(points[off]).max() > 1.1


def test_holes_stay_empty() -> None:
    n, radius = 40_000, 0.1
    options = UniformOptions(n_points=n, noise=0, n_holes=1, hole_radius=radius, outlier_share=0)
    # A ball whose centre lies on the unit sphere cuts a cap of area π r² out of it, wherever it lies.
    share = (radius * ball().diagonal) ** 2 / 4
    for seed in range(3):
        missing = n - len(scan_uniformly(ball(), options, rng(seed)).points)
        assert missing == pytest.approx(n * share, abs=4 * np.sqrt(n * share))


def test_cameras_share_the_holes() -> None:
    whole = RigOptions(**PERFECT)
    holed = RigOptions(**PERFECT | {"n_holes": 1}, hole_radius=0.1)
    seen, left = (scan(ball(), options, rng()).points for options in (whole, holed))
    gone = seen[~np.isin(seen, left).all(axis=1)]
    assert len(gone) > 0
    middle = gone.mean(axis=0) / np.linalg.norm(gone.mean(axis=0))
    radius = 0.1 * ball().diagonal
    assert np.linalg.norm(gone - middle, axis=1).max() < 1.1 * radius
    assert np.linalg.norm(left - middle, axis=1).min() > 0.9 * radius


def test_uniform_points_are_uniform() -> None:
    options = UniformOptions(n_points=40_000, noise=0, n_holes=0, outlier_share=0)
    points = scan_uniformly(ball(), options, rng()).points
    assert points.mean(axis=0) == pytest.approx([0, 0, 0], abs=0.015)
    assert points.T @ points / len(points) == pytest.approx(np.eye(3) / 3, abs=0.01)


def test_sensors_of_uniform_scans_see_their_points() -> None:
    options = UniformOptions(n_points=5_000, noise=0, n_holes=0, outlier_share=0.1, sensors=True)
    cloud = scan_uniformly(ball(), options, rng())
    blind = scan_uniformly(ball(), replace(options, sensors=False), rng())
    assert np.array_equal(cloud.points, blind.points), "a ball hides nothing"
    assert cloud.viewpoints is not None
    assert np.linalg.norm(cloud.viewpoints, axis=1) == pytest.approx(
        RigOptions().distance * ball().diagonal, rel=1e-3
    )
    direction, distance, true = (part[:5_000] for part in rays(cloud))
    # Rays that graze the ball meet its flat faces far from where they meet the ball itself.
    cosine = -np.einsum("ij,ij->i", direction, cloud.points[:5_000])
    assert cosine.min() > np.cos(np.radians(RigOptions().max_incidence)) - 0.05
    assert np.abs(distance - true)[cosine > 0.5].max() < 2 * SAG
    # Uniform directions, each taken with probability cos θ: the mean of cos² over that of cos.
    assert cosine.mean() == pytest.approx(2 / 3, abs=0.05)


def test_what_no_sensor_sees_is_left_out() -> None:
    inner, outer = ball(), TriangleMesh(1.5 * ball().vertices, ball().faces)
    nested = TriangleMesh(
        np.concatenate([outer.vertices, inner.vertices]),
        np.concatenate([outer.faces, inner.faces + len(outer.vertices)]),
    )
    options = UniformOptions(n_points=2_000, noise=0, n_holes=0, outlier_share=0, sensors=True)
    points = scan_uniformly(nested, options, rng()).points
    assert np.linalg.norm(points, axis=1).min() > 1.4
    assert len(points) == pytest.approx(2_000 * 1.5**2 / (1 + 1.5**2), abs=100)
