"""Two layers of points along one surface: views that were registered badly have them, and noise has not."""

from __future__ import annotations

import numpy as np
import pytest
import shapes

from pcretrieve import PointCloud
from pcretrieve.checks import findings_of
from pcretrieve.checks.layers import double_layers
from pcretrieve.options import ScanOptions
from pcretrieve.points import clean, oriented_normals
from pcretrieve.values import FloatArray, TriangleMesh

# A share of the surface beyond which the check "Double walls" is not passed.
SHARE = 0.03


def scanned(
    mesh: TriangleMesh, n: int, *, noise: float, seed: int, shift: float = 0
) -> PointCloud:
    """Points with the normals of the surface, moved along (1, 1, 1); lengths relative to the diagonal."""
    found = shapes.oriented_points_on(mesh, n, noise=noise, seed=seed)
    return PointCloud(found.points + shift * mesh.diagonal / np.sqrt(3), found.normals)


def joined(*clouds: PointCloud) -> PointCloud:
    normals = [cloud.normals for cloud in clouds if cloud.normals is not None]
    return PointCloud(
        np.concatenate([cloud.points for cloud in clouds]), np.concatenate(normals)
    )


def share(cloud: PointCloud) -> float:
    return float((double_layers(cloud).apart > 0).mean())


@pytest.mark.parametrize("n", [6_000, 60_000])
@pytest.mark.parametrize("noise", [0.0002, 0.001, 0.003])
def test_one_layer_of_a_ball(n: int, noise: float) -> None:
    assert share(scanned(shapes.icosphere(5), n, noise=noise, seed=1)) < SHARE


def test_two_sensors_of_different_noise_have_one_layer() -> None:
    ball = shapes.icosphere(5)
    fine = scanned(ball, 12_000, noise=0.0005, seed=1)
    coarse = scanned(ball, 6_000, noise=0.002, seed=2)
    assert share(joined(fine, coarse)) < SHARE


@pytest.mark.parametrize(("noises", "is_found"), [(1, False), (6, True), (10, True)])
def test_a_ball_that_was_scanned_twice(noises: float, is_found: bool) -> None:
    """There is one layer where the ball moved along its surface, and two where along the normal."""
    ball, noise = shapes.icosphere(5), 0.001
    shift = noises * noise
    twice = joined(
        scanned(ball, 10_000, noise=noise, seed=1),
        scanned(ball, 10_000, noise=noise, seed=2, shift=shift),
    )
    found = double_layers(twice)
    assert (share(twice) > 2 * SHARE) == is_found
    if is_found:
        is_layered = found.apart > 0
        along = np.abs(found.places @ np.ones(3)) / np.sqrt(3)  # cosine to the shift
        assert along[is_layered].mean() > along[~is_layered].mean() + 0.2
        farthest = (
            float(np.median(found.apart[is_layered & (along > 0.9)])) / ball.diagonal
        )
        assert shift < farthest < shift + 3 * noise  # the width of two layers of noise


@pytest.mark.parametrize("noise", [0.0002, 0.001])
@pytest.mark.parametrize(
    "mesh",
    [shapes.cube(), shapes.ellipsoid((1, 0.8, 0.015)), shapes.body(5)],
    ids=["sharp folds", "a thin sheet", "limbs"],
)
def test_folds_and_the_two_walls_of_a_thin_sheet_are_no_layers(
    mesh: TriangleMesh, noise: float
) -> None:
    assert share(scanned(mesh, 20_000, noise=noise, seed=3)) < SHARE


def four_views(mesh: TriangleMesh, move: float, turn: float) -> FloatArray:
    """The points that four cameras around a body see, each view moved and turned; diagonals, radians."""
    rng = np.random.default_rng(4)
    surface = shapes.oriented_points_on(mesh, 24_000, seed=4)
    assert surface.normals is not None
    parts = []
    for azimuth in np.arange(4) * np.pi / 2:
        seen = surface.normals @ [np.cos(azimuth), 0, np.sin(azimuth)] > 0.2
        axis, direction = (
            vector / np.linalg.norm(vector) for vector in rng.normal(size=(2, 3))
        )
        points = surface.points[seen]
        points = points + turn * np.cross(axis, points) + move * mesh.diagonal * direction
        parts.append(points + rng.normal(0, 0.0008 * mesh.diagonal, points.shape))
    return np.concatenate(parts)


@pytest.mark.parametrize(
    ("move", "turn", "outcome"),
    [(0.0, 0.0, "passed"), (0.001, 0.003, "passed"), (0.0067, 0.026, "failed")],
    ids=["registered", "2 mm of a person", "12 mm and 1.5 degrees"],
)
def test_the_check_finds_views_that_were_registered_badly(
    move: float, turn: float, outcome: str
) -> None:
    scan = PointCloud(four_views(shapes.body(5), move, turn))
    cleaned, neighbors = clean(scan, ScanOptions())
    cloud = oriented_normals(cleaned, ScanOptions(), neighbors)
    checks = {check.name: check for check in findings_of(cloud, None, None, None).checks}
    walls = checks["Double walls"]
    assert walls.outcome == outcome
    assert ("layers" in walls.shown and walls.error > 0.15) == (outcome == "failed")
