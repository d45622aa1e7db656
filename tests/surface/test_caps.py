"""Large holes are closed by minimal surfaces, and those on which the body can stand are its base."""

from __future__ import annotations

import numpy as np
import pytest
import shapes

from pcretrieve.options import SurfaceOptions
from pcretrieve.surface import SurfaceMarks, body_surfaces
from pcretrieve.values import FloatArray, PointCloud, TriangleMesh

ONCE = SurfaceOptions(reconstructions=1)
EGG = shapes.ellipsoid((0.6, 0.7, 1.0), subdivisions=4)


def part_of(mesh: TriangleMesh, direction: FloatArray, height: float, n: int = 20_000) -> PointCloud:
    """Points of a surface, without those above a plane."""
    cloud = shapes.oriented_points_on(mesh, n)
    return cloud.select(cloud.points @ direction < height)


def surface(cloud: PointCloud) -> tuple[TriangleMesh, SurfaceMarks]:
    return next(body_surfaces(cloud, ONCE))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_cap_is_in_the_plane_of_its_rim(side: float) -> None:
    """The Poisson surface alone bulges beyond the plane by a tenth of the diagonal."""
    down = np.array([0, 0, side])
    mesh, marks = surface(part_of(EGG, down, 0.7))
    assert (mesh.vertices @ down).max() < 0.75  # the rim, by two voxels
    assert np.median(marks.base @ down) == pytest.approx(0.7, abs=0.01)
    # Of the ellipsoid x² / .36 + y² / .49 + z² = 1 below z = .7.
    assert mesh.volume == pytest.approx(np.pi * 0.6 * 0.7 * (1.7 - (1 + 0.7**3) / 3), rel=0.02)
