"""Range images, worked out by hand: a unit square in the plane z = 0, measured from (0, 0, 5)."""

from __future__ import annotations

import numpy as np
import pytest

from pcretrieve.points.register.views import RangeImage
from pcretrieve.values import FloatArray

SENSOR = np.array([0.0, 0.0, 5.0])
UP, DOWN = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, -1.0])
TOLERANCE = 0.1


def image() -> RangeImage:
    ticks = np.linspace(-0.5, 0.5, 41)
    points = np.stack([*np.meshgrid(ticks, ticks), np.zeros((41, 41))], axis=-1).reshape(-1, 3)
    return RangeImage(points, np.broadcast_to(UP, points.shape), SENSOR)


@pytest.mark.parametrize(
    ("point", "normal", "agrees", "contradicts"),
    [
        ((0.1, 0.2, 0.0), UP, True, False),
        ((0.1, 0.2, 0.09), UP, True, False),
        ((0.1, 0.2, 0.0), DOWN, False, False),  # the back of a sheet is not its front
        ((0.1, 0.2, 0.3), UP, False, True),
        ((0.1, 0.2, 0.3), DOWN, False, True),
        ((0.1, 0.2, -0.3), UP, False, False),  # hidden
        ((0.9, 0.0, 0.3), UP, False, False),  # beside the square: not observed
        ((0.1, 0.2, 9.0), UP, False, False),  # behind the sensor
    ],
)
def test_a_point(point: tuple[float, ...], normal: FloatArray, agrees: bool, contradicts: bool) -> None:
    said = image().compare(np.array([point]), normal[None], tolerance=TOLERANCE)
    assert (said.agrees.tolist(), said.contradicts.tolist()) == ([agrees], [contradicts])
