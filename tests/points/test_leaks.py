"""A flood fill that leaks into one part of a body is noticed, however small the part is."""

from __future__ import annotations

import numpy as np
import pytest
import shapes

from pcretrieve.points.neighbors import neighborhoods
from pcretrieve.points.normals import (
    LARGEST_PATCH,
    LEAST_TURNED,
    _agreed,
    _contradicted,
)

BALL = shapes.oriented_points_on(shapes.ellipsoid((1, 1, 1), subdivisions=4), 20_000)


@pytest.mark.parametrize(("share", "has_leaked"), [(0, False), (0.2, False), (4, True)])
def test_a_patch_of_normals_that_disagree_is_a_leak(
    share: float, has_leaked: bool
) -> None:
    """In a leak the two sides of a shell have any normals: every other point of the patch is turned."""
    assert BALL.normals is not None
    n = len(BALL.points)
    nearest_first = np.argsort(-BALL.points[:, 2])
    patch = nearest_first[: int(share * LARGEST_PATCH * n)]
    normals = BALL.normals.copy()
    normals[patch[::2]] *= -1
    near = neighborhoods(BALL.points, 9).near
    largest = _contradicted(normals, near, np.ones(n, dtype=np.bool_))
    assert (largest > LARGEST_PATCH * n) == has_leaked


def test_points_that_disagree_here_and_there_are_no_leak() -> None:
    assert BALL.normals is not None
    n = len(BALL.points)
    normals = BALL.normals.copy()
    normals[np.random.default_rng(0).choice(n, n // 100, replace=False)] *= -1
    near = neighborhoods(BALL.points, 9).near
    largest = _contradicted(normals, near, np.ones(n, dtype=np.bool_))
    assert largest <= LARGEST_PATCH * n


def test_a_whole_that_disagrees_is_a_leak() -> None:
    assert BALL.normals is not None
    normals = BALL.normals * np.random.default_rng(0).choice(
        [-1, 1], (len(BALL.points), 1)
    )
    near = neighborhoods(BALL.points, 9).near
    assert _contradicted(normals, near, np.ones(len(near), dtype=np.bool_)) == len(near)


@pytest.mark.parametrize(
    ("size", "is_mended"), [(LEAST_TURNED - 6, False), (30, True), (400, False)]
)
def test_a_small_patch_that_all_around_contradicts_is_turned(
    size: int, is_mended: bool
) -> None:
    assert BALL.normals is not None
    normals = BALL.normals.copy()
    normals[np.argsort(-BALL.points[:, 2])[:size]] *= -1
    found, n_turned = _agreed(normals, neighborhoods(BALL.points, 9).near)
    assert np.array_equal(found, BALL.normals if is_mended else normals)
    assert n_turned == (size if is_mended else 0)
