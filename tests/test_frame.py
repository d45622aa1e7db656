"""The coordinates that single precision can bear: of one size, near the origin, and exact both ways."""

from __future__ import annotations

import numpy as np
import pytest

from pcretrieve.arrays import DOUBLE_OFFSET, SINGLE_OFFSET, Frame, power_of_two
from pcretrieve.values import bounding_diagonal

POINTS = np.random.default_rng(0).uniform(-0.4, 0.4, (50, 3))


@pytest.mark.parametrize("unit", [1e-49, 3e-5, 1.0, 7e8, 1e49])
@pytest.mark.parametrize("place", [0.0, -0.3, 40.0, 1e7])
def test_points_have_one_size_and_lie_near_the_origin(unit: float, place: float) -> None:
    points = (POINTS + place) * unit
    for offset in (SINGLE_OFFSET, DOUBLE_OFFSET):
        framed = Frame.around(points, offset=offset).inward(points)
        assert 0.5 <= bounding_diagonal(framed) < 1
        middle = (framed.min(axis=0) + framed.max(axis=0)) / 2
        assert (np.abs(middle) <= offset).all()


@pytest.mark.parametrize("unit", [1e-49, 1.0, 1e49])
def test_round_the_origin_no_digit_is_lost(unit: float) -> None:
    points = POINTS * unit
    frame = Frame.around(points)
    np.testing.assert_array_equal(frame.outward(frame.inward(points)), points)
    doubled = Frame.around(2 * points)
    np.testing.assert_array_equal(doubled.inward(2 * points), frame.inward(points))


def test_points_in_one_place_have_a_frame() -> None:
    for points in (np.zeros((0, 3)), np.full((3, 3), 1e16)):
        assert np.abs(Frame.around(points).inward(points)).max(initial=0) == 0


def test_the_power_of_two_above_a_length() -> None:
    assert [power_of_two(length) for length in (0.0, 0.5, 0.75, 1.9, 2.0)] == [1, 1, 1, 2, 4]
