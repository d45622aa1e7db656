"""The coarse surface, which closes the holes of a scan."""

from __future__ import annotations

import numpy as np
import pytest
import shapes

from pcretrieve.options import SurfaceOptions
from pcretrieve.points.density import local_spacings
from pcretrieve.points.grid import Grid
from pcretrieve.points.neighbors import SPACING_NEIGHBORS, neighborhoods, spacing
from pcretrieve.points.outside import sampled
from pcretrieve.surface.caps import NO_CAP
from pcretrieve.surface.coarse import coarse_surface, indicator
from pcretrieve.surface.topology import defects
from pcretrieve.values import FloatArray, PointCloud

EGG = shapes.ellipsoid((0.6, 0.7, 1.0), subdivisions=4)


def values_at(cloud: PointCloud, places: FloatArray, unit: float = 1.0) -> FloatArray:
    """The indicator function of a body whose diagonal is about 3 units."""
    points = unit * cloud.points
    grid = Grid.around(points, 0.04 * unit, 10)
    assert cloud.normals is not None
    spacings = local_spacings(neighborhoods(points, SPACING_NEIGHBORS + 1))
    return sampled(indicator(points, cloud.normals, spacings, grid), grid.coordinates(unit * places))


def without_top(height: float) -> PointCloud:
    cloud = shapes.oriented_points_on(EGG, 20_000)
    return cloud.select(cloud.points[:, 2] < height)


@pytest.mark.parametrize("unit", [1.0, 1e-160, 1e100])
def test_the_indicator_function_is_one_inside_and_zero_outside(unit: float) -> None:
    inside, outside = 0.8 * EGG.vertices, 1.2 * EGG.vertices
    cloud = shapes.oriented_points_on(EGG, 20_000)
    assert values_at(cloud, inside, unit) == pytest.approx(1, abs=0.2)
    assert values_at(cloud, outside, unit) == pytest.approx(0, abs=0.1)


def closed(cloud: PointCloud) -> tuple[float, bool]:
    """The volume of the coarse surface, and whether it has caps."""
    found = coarse_surface(cloud, SurfaceOptions(), spacing=spacing(neighborhoods(cloud.points, 9)))
    assert defects(found.surface).boundary_edges == 0
    return found.surface.volume, bool((found.cap != NO_CAP).any())


def test_small_holes_are_closed_and_large_ones_are_capped() -> None:
    whole = 4 / 3 * np.pi * 0.6 * 0.7
    volume, has_caps = closed(shapes.oriented_points_on(EGG, 20_000))
    assert volume == pytest.approx(whole, rel=0.07) and not has_caps
    volume, has_caps = closed(without_top(0.996))
    assert volume == pytest.approx(whole, rel=0.07) and not has_caps
    volume, has_caps = closed(without_top(0.7))
    assert volume == pytest.approx(np.pi * 0.6 * 0.7 * (1.7 - (1 + 0.7**3) / 3), rel=0.04) and has_caps
