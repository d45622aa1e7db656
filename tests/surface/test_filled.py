from __future__ import annotations

import numpy as np
import pytest

from pcretrieve.points.grid import Grid
from pcretrieve.surface.coarse import BESIDE, filled
from pcretrieve.values import FloatArray, TriangleMesh

GRID = Grid(np.array([1.0, -2.0, 3.0]), 0.5, (24, 24, 24))
RADIUS = 8.234  # voxels


def octahedron(centre: FloatArray) -> TriangleMesh:
    corners = np.concatenate([np.eye(3), -np.eye(3)]) * RADIUS + centre
    faces = [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]]
    return TriangleMesh(corners * GRID.cell + GRID.origin, np.array(faces, dtype=np.int32))


@pytest.mark.parametrize(
    "centre",
    [
        pytest.param([12.31, 11.62, 12.27], id="anywhere"),
        pytest.param([12 + BESIDE[0], 12 + BESIDE[1], 12.3], id="edges-on-lines"),
        pytest.param([12 + BESIDE[0], 12 + BESIDE[0], 12 + BESIDE[1]], id="vertices-on-lines"),
        pytest.param([12.0, 12.0, 12.0], id="vertices-on-cells"),
    ],
)
def test_cells_inside_are_those_of_the_solid(centre: list[float]) -> None:
    inside, _ = filled(octahedron(np.array(centre)), GRID)
    cells = np.moveaxis(np.indices(GRID.shape), 0, -1)
    np.testing.assert_array_equal(inside, np.abs(cells - centre).sum(axis=-1) < RADIUS)


def test_crossings_lie_on_the_surface() -> None:
    centre = np.array([12.31, 11.62, 12.27])
    inside, crossings = filled(octahedron(centre), GRID)
    for axis in range(3):
        here = np.argwhere(np.isfinite(crossings[axis]))
        turns = np.argwhere(np.diff(inside.astype(int), axis=axis))
        # A line near an edge may cross the mesh twice between two voxels.
        assert set(map(tuple, turns)) <= set(map(tuple, here))
        places = here.astype(float)
        places[:, axis] += crossings[axis][tuple(here.T)]
        np.testing.assert_allclose(np.abs(places - centre).sum(axis=1), RADIUS, atol=1e-3)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("end", [3.31, 19.62])
def test_what_sticks_out_of_the_grid_is_cut_off_at_its_border(axis: int, end: float) -> None:
    centre = np.full(3, 12.27)
    centre[axis] = end
    inside, _ = filled(octahedron(centre), GRID)
    cells = np.moveaxis(np.indices(GRID.shape), 0, -1)
    solid = np.abs(cells - centre).sum(axis=-1) < RADIUS
    for side in (0, -1):
        solid[side] = solid[:, side] = solid[:, :, side] = False
    np.testing.assert_array_equal(inside, solid)
