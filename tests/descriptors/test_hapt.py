"""Histograms of the area projection transform, and moments."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
import shapes
import trimesh

from pcretrieve.descriptors import describe, hapt
from pcretrieve.descriptors.hapt import (
    CELL,
    LEVELS,
    PSEUDOCOUNT,
    RADII,
    STEP,
    WEIGHTS,
    WIDE,
    _counted,
    _vertex_normals,
    in_principal_frame,
    interior,
    moments,
    projected_areas,
)
from pcretrieve.errors import DegenerateMeshError
from pcretrieve.options import SignatureOptions
from pcretrieve.values import FloatArray, Grid, Shape, Surface, TriangleMesh


def tube(radius: float, length: float, *, bend: float = 0.0) -> TriangleMesh:
    """A closed tube with round caps, bent by an angle along a circular arc."""
    n_along, n_around = 121, 48
    t = np.linspace(-1, 1, n_along)[1:-1]
    # The ends of the profile are half circles, with as many rows as the middle has for that length.
    along = t * (length / 2 + radius)
    over = np.maximum(np.abs(along) - length / 2, 0)
    profile = np.sqrt(np.maximum(radius**2 - over**2, 0))
    angle = 2 * np.pi * np.arange(n_around) / n_around
    x, y = (profile[:, np.newaxis] * of_angle(angle) for of_angle in (np.cos, np.sin))
    z = np.broadcast_to(along[:, np.newaxis], x.shape)
    tips = np.array([[0, 0, -length / 2 - radius], [0, 0, length / 2 + radius]])
    vertices = np.concatenate([np.stack([x, y, z], axis=-1).reshape(-1, 3), tips])
    if bend:
        arc = (length + 2 * radius) / bend  # radius of the arc of the axis
        turn, reach = vertices[:, 2] / arc, arc - vertices[:, 0]
        vertices = np.column_stack(
            [arc - reach * np.cos(turn), vertices[:, 1], reach * np.sin(turn)]
        )
    here = np.arange(x.size).reshape(x.shape)
    beside = np.roll(here, -1, axis=1)
    a, b, c, d = (
        corner.ravel() for corner in (here[:-1], beside[:-1], beside[1:], here[1:])
    )
    first, last = np.full(n_around, x.size), np.full(n_around, x.size + 1)
    faces = (
        (a, b, c),
        (a, c, d),
        (beside[0], here[0], first),
        (here[-1], beside[-1], last),
    )
    return TriangleMesh(
        vertices, np.concatenate([np.column_stack(corners) for corners in faces])
    )


def roots(mesh: TriangleMesh) -> FloatArray:
    return np.sqrt(hapt(mesh).values)


def test_the_area_of_a_sphere_arrives_at_its_centre() -> None:
    """Unit area: R = 1 / √(4 π)."""
    radius = 1 / np.sqrt(4 * np.pi)
    ball = in_principal_frame(shapes.icosphere(4))
    transform = projected_areas(ball, np.array([radius]), 0.25, CELL)
    assert transform.max() == pytest.approx(1, abs=0.01)
    assert transform.shape[1] * CELL**3 == pytest.approx(
        4 / 3 * np.pi * radius**3, rel=0.01
    )
    expected = radius * np.repeat(np.sqrt([1 / 3, 3 / 5]), 3)  # σ² = R² / 3, m₄ = R⁴ / 5
    np.testing.assert_allclose(moments(shapes.icosphere(4)).values, expected, rtol=0.01)


def test_half_of_a_sphere_arrives_on_the_axis_of_a_tube() -> None:
    """On the axis of a tube of radius R, a length 2 c R of it arrives: 2 π R · 2 c R of 4 π R²."""
    thin = tube(0.05, 1.5)
    radius = 0.05 / np.sqrt(thin.area)
    radii = np.array([radius / 2, radius, 2 * radius])
    transform = projected_areas(in_principal_frame(thin), radii, 0.5, CELL)
    half, own, double = transform
    # Where the ends of the tube do not contribute: the median of the voxels on its axis.
    on_axis = own > np.quantile(own, 0.97)
    assert np.median(own[on_axis]) == pytest.approx(0.5, rel=0.1)
    assert np.median(half[on_axis]) < 0.1
    assert np.median(double[on_axis]) < 0.1


def test_voxels_near_a_level_count_in_part() -> None:
    """The sum over all voxels of how far each is above half a step below a level, in steps of at most one."""
    areas = np.random.default_rng(0).lognormal(-2, 2, (3, 500)).astype(np.float32)
    areas[:, :9] = 0
    steps = np.log(np.maximum(areas, 1e-9)[..., np.newaxis] / LEVELS) / np.log(STEP)
    expected = (steps + 0.5).clip(0, 1).sum(axis=1)
    np.testing.assert_allclose(_counted(areas), expected, rtol=1e-6)


def test_bending_changes_less_than_girth() -> None:
    straight = roots(tube(0.1, 2.0))
    bent = np.linalg.norm(roots(tube(0.1, 2.0, bend=np.pi / 2)) - straight)
    thicker = np.linalg.norm(roots(tube(0.12, 2.0)) - straight)
    assert 4 * bent < thicker


def test_errors_of_grids_cancel_in_the_mean_over_both() -> None:
    """A thin tube is bent by some more: its axis passes by the voxels in other places."""
    options = SignatureOptions(method="hapt")
    bent = [
        Surface(1.0, mesh=tube(0.02, 2.0, bend=bend))
        for bend in np.linspace(0.5, 0.6, 12)
    ]
    on_one, on_both, of_two = (
        [
            np.sqrt(describe(Shape(n * (surface,), number=number), options).values)
            for surface in bent
        ]
        for n, number in ((1, 0), (1, None), (2, None))
    )
    np.testing.assert_allclose(on_both, of_two, rtol=1e-12)
    errors = [np.linalg.norm(np.std(found, axis=0)) for found in (on_one, on_both)]
    assert errors[1] < 0.7 * errors[0]


@pytest.mark.parametrize("make", [hapt, partial(hapt, number=1), moments])
def test_rotation_reflection_scale_and_orientation_change_nothing(make) -> None:  # type: ignore[no-untyped-def]
    body = shapes.body(3)
    expected = make(body).values
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    for moved in (turn, turn @ np.diag([1.0, 1.0, -1.0])):  # one of them is a reflection
        found = make(
            TriangleMesh(3e-4 * body.vertices @ moved + [5, -7, 1], body.faces)
        ).values
        np.testing.assert_allclose(found, expected, atol=2e-6)
    turned = TriangleMesh(body.vertices, body.faces[:, ::-1])
    np.testing.assert_allclose(make(turned).values, expected, rtol=1e-12)


def test_thin_parts_between_the_wide_voxels_have_no_volumes_there() -> None:
    """Two sheets of unit area, from .004 to .016 √A above and below the centre."""
    sheets = []
    for side in (-1, 1):
        box = trimesh.creation.box((0.488, 0.488, 0.012))
        box.apply_translation((0, 0, 0.01 * side))
        faces = np.array(box.faces, np.int32)
        sheets.append(TriangleMesh(np.array(box.vertices), faces))
    volumes = hapt(shapes.joined(*sheets), number=0).values.reshape(22, 7) / WEIGHTS
    is_filled = volumes > (1 + 1e-9) * PSEUDOCOUNT
    assert is_filled[RADII < WIDE].any() and not is_filled[RADII >= WIDE].any()


def test_a_body_that_is_all_length_needs_too_large_a_grid() -> None:
    """A thin tube on three axes: its grid has as many voxels as the cube around it."""
    arm = tube(0.004, 2.0)
    arms = (
        TriangleMesh(arm.vertices @ np.roll(np.eye(3), turn, axis=1), arm.faces)
        for turn in range(3)
    )
    message = r"at most 16,777,216 voxels of 0.01 √area, got [\d,]+: the"
    with pytest.raises(DegenerateMeshError, match=message):
        hapt(shapes.joined(*arms))


def test_normals_at_vertices_do_not_depend_on_how_sides_are_divided() -> None:
    """Each corner of a cube has one direction, though one of its sides has one triangle or two there."""
    cube = trimesh.creation.box()
    vertices = np.array(cube.vertices)
    normals = _vertex_normals(vertices, np.array(cube.faces, dtype=np.int32))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    outward = np.sign(vertices) / np.sqrt(3)
    np.testing.assert_allclose(normals, outward, atol=1e-12)


# --- the inside of a surface --------------------------------------------------------------------------


def filled(mesh: TriangleMesh, around: TriangleMesh) -> tuple[np.ndarray, FloatArray]:
    """The voxels inside a mesh, and the distance of each voxel from the origin."""
    grid = Grid.around(around.vertices, 0.05, margin=2)
    at = np.moveaxis(np.indices(grid.shape), 0, -1)
    return interior(mesh, grid), np.linalg.norm(grid.centres(at), axis=-1)


def test_voxels_of_a_ball_are_inside_and_those_of_a_cavity_are_not() -> None:
    ball, inner = shapes.icosphere(4), shapes.icosphere(3, radius=0.6)
    turned, cavity = (
        TriangleMesh(mesh.vertices, mesh.faces[:, ::-1]) for mesh in (ball, inner)
    )
    above = ball.vertices[ball.faces].mean(axis=1)[:, 2] > 0.95
    # A hole is closed by the lines along two other axes.
    pricked = TriangleMesh(ball.vertices, ball.faces[~above])
    for mesh, depth in ((ball, 0.99), (turned, 0.99), (pricked, 0.9)):
        inside, distance = filled(mesh, ball)
        assert inside[distance < depth].all() and not inside[distance > 1].any()
    inside, distance = filled(shapes.joined(ball, cavity), ball)
    assert (
        inside[(distance > 0.62) & (distance < 0.97)].all()
        and not inside[distance < 0.58].any()
    )


def test_lines_through_vertices_and_edges_are_counted_once() -> None:
    """A cube whose vertices, edges and faces are on the lines of the grid."""
    corners = (
        np.array(np.meshgrid([0.0, 1.0], [0.0, 1.0], [0.0, 1.0], indexing="ij"))
        .reshape(3, -1)
        .T
    )
    faces = np.array(
        [
            *([0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]),
            *([2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]),
        ]
    )
    inside = interior(
        TriangleMesh(corners, faces), Grid(np.full(3, -0.5), 0.25, (9, 9, 9))
    )
    assert inside[3:6, 3:6, 3:6].all(), (
        "the voxels whose centres are inside, not on the surface"
    )
    inside[2:7, 2:7, 2:7] = False
    assert not inside.any()
