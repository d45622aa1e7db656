from __future__ import annotations

import numpy as np
import pytest
import shapes

from pcretrieve.points.neighbors import neighborhoods, noise, spacing


def test_regular_and_random_samplings_have_the_same_spacing() -> None:
    side, n = 0.02, 50
    i, j = np.indices((n, n)).reshape(2, -1)
    plane = np.zeros(n * n)
    regular = side * np.column_stack([i, j, plane])
    scattered = np.random.default_rng(0).random((n * n, 3)) * [side * n, side * n, 0]
    assert spacing(neighborhoods(regular, 9)) == pytest.approx(side, rel=0.15)
    assert spacing(neighborhoods(scattered, 9)) == pytest.approx(side, rel=0.15)


@pytest.mark.parametrize("n_points", [10_000, 40_000])
@pytest.mark.parametrize("deviation", [0.0005, 0.002])
def test_noise_is_what_was_added_however_many_points_there_are(n_points: int, deviation: float) -> None:
    points = shapes.oriented_points_on(shapes.ellipsoid(), n_points).points
    diagonal = float(np.linalg.norm(np.ptp(points, axis=0)))
    noisy = points + np.random.default_rng(0).normal(0, deviation * diagonal, points.shape)
    assert noise(noisy, neighborhoods(noisy, 9, of_some=True)) == pytest.approx(
        0.8 * deviation * diagonal, rel=0.25
    )
