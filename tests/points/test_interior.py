"""The voxels inside a surface."""

from __future__ import annotations

import numpy as np
import pytest
import shapes

from pcretrieve.points.grid import Grid, interior
from pcretrieve.values import TriangleMesh

CELL = 0.05


def grid_around(mesh: TriangleMesh) -> Grid:
    return Grid.around(mesh.vertices, CELL, margin=2)


def radii(grid: Grid) -> np.ndarray:
    """The distance of each voxel from the origin."""
    indices = np.moveaxis(np.indices(grid.shape), 0, -1)
    length: np.ndarray = np.linalg.norm(indices * grid.cell + grid.origin, axis=-1)
    return length


@pytest.mark.parametrize("inwards", [False, True])
def test_voxels_of_a_ball(inwards: bool) -> None:
    ball = shapes.icosphere(4)
    if inwards:
        ball = TriangleMesh(ball.vertices, ball.faces[:, ::-1])
    grid = grid_around(ball)
    inside, distance = interior(ball, grid), radii(grid)
    assert inside[distance < 0.99].all()
    assert not inside[distance > 1].any()


def test_a_cavity_is_outside() -> None:
    outer, inner = shapes.icosphere(3), shapes.icosphere(3, radius=0.6)
    hollow = TriangleMesh(
        np.concatenate([outer.vertices, inner.vertices]),
        np.concatenate([outer.faces, inner.faces[:, ::-1] + len(outer.vertices)]),
    )
    grid = grid_around(hollow)
    inside, distance = interior(hollow, grid), radii(grid)
    assert inside[(distance > 0.62) & (distance < 0.97)].all()
    assert not inside[distance < 0.58].any()


def test_lines_through_vertices_and_edges_are_counted_once() -> None:
    """A cube whose vertices, edges and faces are on the lines of the grid."""
    corners = np.array(np.meshgrid([0.0, 1.0], [0.0, 1.0], [0.0, 1.0], indexing="ij")).reshape(3, -1).T
    faces = np.array(
        [
            *([0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]),
            *([2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]),
        ]
    )
    grid = Grid(np.full(3, -0.5), 0.25, (9, 9, 9))
    inside = interior(TriangleMesh(corners, faces), grid)
    assert inside[3:6, 3:6, 3:6].all(), "the voxels whose centres are inside, not on the surface"
    outside = inside.copy()
    outside[2:7, 2:7, 2:7] = False
    assert not outside.any()


def test_a_hole_is_closed_by_the_lines_along_two_other_axes() -> None:
    ball = shapes.icosphere(4)
    above = ball.vertices[ball.faces].mean(axis=1)[:, 2] > 0.95
    holed = TriangleMesh(ball.vertices, ball.faces[~above])
    assert above.any()
    grid = grid_around(ball)
    inside, distance = interior(holed, grid), radii(grid)
    assert inside[distance < 0.9].all()
    assert not inside[distance > 1].any()
