"""The coarse surface, which closes the holes of a scan: its indicator function, its caps, what it fills."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapes

from pcretrieve.options import SurfaceOptions
from pcretrieve.points.density import local_spacings
from pcretrieve.points.grid import Grid
from pcretrieve.points.neighbors import SPACING_NEIGHBORS, neighborhoods, spacing
from pcretrieve.points.outside import sampled
from pcretrieve.surface import body_surfaces
from pcretrieve.surface.caps import NO_CAP
from pcretrieve.surface.coarse import BESIDE, coarse_surface, filled, indicator
from pcretrieve.surface.topology import defects
from pcretrieve.values import FloatArray, TriangleMesh

EGG = shapes.ellipsoid((0.6, 0.7, 1.0), subdivisions=4)
ON_EGG = shapes.oriented_points_on(EGG, 20_000)


def volume_below(height: float) -> float:
    """Of the ellipsoid x² / .36 + y² / .49 + z² = 1 below a plane."""
    return np.pi * 0.6 * 0.7 * (1 + height - (1 + height**3) / 3)


@pytest.mark.parametrize("unit", [1.0, 1e-160, 1e100])
def test_the_indicator_function_is_one_inside_and_zero_outside(unit: float) -> None:
    points = unit * ON_EGG.points
    grid = Grid.around(points, 0.04 * unit, 10)
    assert ON_EGG.normals is not None
    spacings = local_spacings(neighborhoods(points, SPACING_NEIGHBORS + 1))
    values = indicator(points, ON_EGG.normals, spacings, grid)
    for reach, expected, error in ((0.8, 1, 0.2), (1.2, 0, 0.1)):
        at = grid.coordinates(unit * reach * EGG.vertices)
        assert sampled(values, at) == pytest.approx(expected, abs=error)


def test_small_holes_are_closed_and_large_ones_are_capped() -> None:
    for height, expected, error in ((2.0, 1.0, 0.07), (0.996, 1.0, 0.07), (0.7, 0.7, 0.04)):
        cloud = ON_EGG.select(ON_EGG.points[:, 2] < height)
        found = coarse_surface(cloud, SurfaceOptions(), spacing=spacing(neighborhoods(cloud.points, 9)))
        assert defects(found.surface).boundary_edges == 0
        assert found.surface.volume == pytest.approx(volume_below(expected), rel=error)
        assert (found.cap != NO_CAP).any() == (height == 0.7)


@pytest.mark.parametrize("side", [1, -1], ids=["top", "base"])
def test_a_cap_is_in_the_plane_of_its_rim(side: int) -> None:
    """The Poisson surface alone bulges beyond the plane by a tenth of the diagonal."""
    down = np.array([0, 0, side])
    cloud = ON_EGG.select(ON_EGG.points @ down < 0.7)
    if side < 0:
        cloud = replace(cloud, viewpoints=5 * cloud.points)
    mesh, marks = next(body_surfaces(cloud, SurfaceOptions(reconstructions=1)))
    assert (mesh.vertices @ down).max() < 0.75  # the rim, by two voxels
    assert np.median(marks.base @ down) == pytest.approx(0.7, abs=0.01)
    assert mesh.volume == pytest.approx(volume_below(0.7), rel=0.02)


# --- what is inside -----------------------------------------------------------------------------------

GRID = Grid(np.array([1.0, -2.0, 3.0]), 0.5, (24, 24, 24))
RADIUS = 8.234  # voxels


def octahedron(centre: FloatArray) -> tuple[TriangleMesh, np.ndarray]:
    """The mesh, and the voxels whose centres it contains."""
    corners = np.concatenate([np.eye(3), -np.eye(3)]) * RADIUS + centre
    faces = [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]]
    solid = np.abs(np.moveaxis(np.indices(GRID.shape), 0, -1) - centre).sum(axis=-1) < RADIUS
    return TriangleMesh(GRID.centres(corners), np.array(faces, dtype=np.int32)), solid


def test_voxels_inside_are_those_of_the_solid_but_for_the_border_of_the_grid() -> None:
    for centre in (
        [12.31, 11.62, 12.27],
        [12 + BESIDE[0], 12 + BESIDE[1], 12.3],  # edges on lines
        [12 + BESIDE[0], 12 + BESIDE[0], 12 + BESIDE[1]],  # vertices on lines
        [12.0, 12.0, 12.0],  # vertices on voxels
        # What sticks out of the grid is cut off.
        *(np.where(np.arange(3) == axis, end, 12.27) for axis in range(3) for end in (3.31, 19.62)),
    ):
        mesh, solid = octahedron(np.array(centre))
        solid = np.pad(solid[1:-1, 1:-1, 1:-1], 1)
        np.testing.assert_array_equal(filled(mesh, GRID)[0], solid)


def test_crossings_lie_on_the_surface() -> None:
    centre = np.array([12.31, 11.62, 12.27])
    inside, crossings = filled(octahedron(centre)[0], GRID)
    for axis in range(3):
        here = np.argwhere(np.isfinite(crossings[axis]))
        turns = np.argwhere(np.diff(inside.astype(int), axis=axis))
        # A line near an edge may cross the mesh twice between two voxels.
        assert set(map(tuple, turns)) <= set(map(tuple, here))
        places = here.astype(float)
        places[:, axis] += crossings[axis][tuple(here.T)]
        np.testing.assert_allclose(np.abs(places - centre).sum(axis=1), RADIUS, atol=1e-3)
