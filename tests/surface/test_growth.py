"""Voxels → one ball, of which little is lost, cut where parts touch → its surface, by marching cubes."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import shapes
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter, label

from pcretrieve.points.voxels import distances
from pcretrieve.surface.growth import grown
from pcretrieve.surface.marching import (
    SHRINK,
    SWELL,
    Crossings,
    crossed,
    marched,
    smoothed,
)
from pcretrieve.surface.parts import (
    DETOUR,
    LEAST_GROOVE,
    LEAST_LEAN,
    RIM,
    SHALLOW,
    _counted,
    contact_layer,
    walls as links_across,
    without_grooves,
)
from pcretrieve.values import FloatArray, TriangleMesh
from pcretrieve.values.geometry import adjacency
from pcretrieve.values.topology import SOUND, defects

Mask = NDArray[np.bool_]


def blob(seed: int, n: int = 40) -> Mask:
    """Voxels in which smooth noise is above its mean: handles, cavities and several components."""
    noise = gaussian_filter(np.random.default_rng(seed).standard_normal((n, n, n)), 2.0)
    return np.pad(noise > 0, 1)


def ring(major: float, minor: float, n: int = 40) -> Mask:
    x, y, z = np.indices((n, n, n)) - (n - 1) / 2
    return np.asarray((np.hypot(x, y) - major) ** 2 + z**2 < minor**2)


def no_walls(inside: Mask) -> Mask:
    return np.zeros((3, *inside.shape), dtype=bool)


def lost(inside: Mask, walls: Mask) -> Mask:
    depth: NDArray[np.float32] = distance_transform_edt(inside).astype(np.float32)
    body = grown(inside, depth, np.full_like(depth, np.inf), walls)
    assert not (body & ~inside).any()
    return inside & ~body


def euler(body: Mask) -> int:
    mesh = TriangleMesh(*marched(body))
    assert not defects(mesh)
    return mesh.euler_characteristic


def test_a_region_is_one_ball_and_a_ring_loses_one_slice() -> None:
    for inside in (*map(blob, range(2)), ring(12, 5)):
        cut = lost(inside, no_walls(inside))
        body = inside & ~cut
        assert label(body)[1] == 1
        assert label(~body, np.ones((3, 3, 3)))[1] == 1
        assert euler(body) == 2
    assert 0 < cut.sum() < 2 * np.pi * 5**2  # two layers
    assert label(cut, np.ones((3, 3, 3)))[1] == 1
    at = np.argwhere(cut) - 19.5
    assert np.degrees(np.ptp(np.unwrap(np.arctan2(at[:, 1], at[:, 0])))) < 45


def test_walls_keep_apart_what_is_thickest_where_it_touches() -> None:
    """Two bars whose contact is twice as deep as they are: only the surfels between them show it."""
    inside, place = np.zeros((44, 19, 11), dtype=bool), 24
    inside[2:6, 2:17, 2:9] = inside[6:42, 2:9, 2:9] = inside[6:42, 10:17, 2:9] = True
    inside[place : place + 6, 9, 2:9] = True
    assert euler(inside) == 0
    walls = no_walls(inside)
    walls[1, place : place + 6, 9] = True  # between the contact and the upper bar
    cut = lost(inside, walls)
    assert cut.any()
    cut[place : place + 6, 9:11] = False
    assert not cut.any()
    unguided = lost(inside, no_walls(inside))
    assert not unguided[place : place + 6].any()


def test_a_link_crosses_a_surfel_where_a_line_meets_a_disk() -> None:
    random = np.random.default_rng(0)
    at, normals = random.uniform(0, 8, size=(30, 3)), random.normal(size=(30, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    shape, radius = (8, 9, 10), 1.7
    expected = np.zeros((3, *shape), dtype=bool)
    for axis, start in (
        (axis, start) for axis in range(3) for start in np.ndindex(shape)
    ):
        steep = np.abs(normals[:, axis]) >= LEAST_LEAN
        share = np.einsum("ij,ij->i", at - start, normals) / normals[:, axis]
        place = np.array(start) + share[:, np.newaxis] * np.eye(3)[axis]
        near = np.linalg.norm(place - at, axis=1) <= radius
        expected[axis][start] = (steep & near & (share >= 0) & (share < 1)).any()
    np.testing.assert_array_equal(links_across(at, normals, shape, radius), expected)


def test_points_count_for_the_piece_that_they_are_in_or_beside() -> None:
    pieces = np.zeros((8, 4, 4), dtype=np.int32)
    pieces[1:3, 1:3, 1:3], pieces[5:7, 1:3, 1:3] = 1, 2
    at = np.array([[1.4, 1, 1], [2.6, 2, 2], [6.4, 1, 2], [4.4, 1, 1], [5.6, 2.4, 2]])
    assert _counted(pieces, at, 3).tolist() == [0, 2, 3]


@pytest.mark.parametrize("reach", [10, 14, 18])
def test_a_fold_is_parted_in_one_layer_as_deep_as_it_goes(reach: int) -> None:
    """A slab, whose shape does not show that it is folded, with points half way up to a depth of `reach`."""
    n = 30
    inside = np.pad(np.ones((n - 6, n - 6, 6), dtype=bool), 3)
    x, z = np.meshgrid(np.arange(3, 3 + reach), np.arange(12), indexing="ij")
    points = np.column_stack([x.ravel(), np.full(x.size, n / 2), z.ravel()]).astype(float)
    links = links_across(points, np.tile([0.0, 1.0, 0.0], (len(points), 1)), inside.shape)
    nothing, depth = no_walls(inside), distances(~inside, np.inf)
    assert not contact_layer(inside, nothing, nothing, depth).any()
    found = contact_layer(inside, links, nothing, depth)
    (layer,) = np.flatnonzero(found.any(axis=(0, 2)))
    assert abs(layer - n / 2) <= 1
    # Near the end of the fold the detour is short, and the parts are not separated.
    deepest = np.flatnonzero(found.any(axis=(1, 2))).max() - 2
    assert reach - DETOUR / 2 <= deepest <= reach + 2
    legs, n_legs = label((inside & ~found)[3 : 3 + reach - DETOUR // 2])
    assert n_legs == 2
    assert legs[0, 5, 6] != legs[0, -5, 6]


def groove(n: int, depth: int, gap: float) -> tuple[Mask, Mask]:
    """A layer of n voxels below the surface of a slab, and what is left of it without grooves.

    Below the surface, at some depth, the layer lies between two walls of points that face each other.

    gap: between the walls; in voxels.
    """
    inside = np.pad(np.ones((60, 9, 9), dtype=bool), 3)
    layer = np.zeros_like(inside)
    layer[6 : 6 + n, 7, 2 + depth] = True
    places = np.argwhere(layer).astype(float)
    walls = [places + side * np.array([0, gap / 2, 0]) for side in (-1, 1)]
    normals = [np.tile([0.0, -side, 0.0], (n, 1)) for side in (-1, 1)]
    at, normal = np.concatenate(walls), np.concatenate(normals)
    occupied = np.zeros_like(inside)
    occupied[tuple(np.rint(at).astype(int).T)] = True
    to_points = distances(occupied, np.inf)
    return layer, without_grooves(layer, inside, at, normal, to_points)


def test_a_groove_is_large_and_shallow_and_no_points_face_each_other_across_it() -> None:
    few, many = LEAST_GROOVE - 1, LEAST_GROOVE
    shallow, deep = int(SHALLOW), int(SHALLOW) + 1
    wide, narrow = 2 * RIM, RIM - 1
    assert not groove(many, shallow, wide)[1].any()
    for kept in ((few, shallow, wide), (many, deep, wide), (many, shallow, narrow)):
        layer, left = groove(*kept)
        np.testing.assert_array_equal(left, layer)


# --- marching cubes ----------------------------------------------------------------------------------


def surface(body: Mask, crossings: FloatArray) -> TriangleMesh:
    """With (3, a, b, c) crossings on the links."""
    return TriangleMesh(
        *marched(
            body,
            [
                Crossings(at, crossings[axis][tuple(at.T)])
                for axis, at in enumerate(crossed(body))
            ],
        )
    )


def digital_euler(body: Mask) -> int:
    """Euler number of a 6-connected set: voxels − pairs + squares of four − cubes of eight."""
    total = 0
    for along in np.ndindex(2, 2, 2):
        cells = body
        for axis in np.flatnonzero(along):
            cells = np.logical_and(*(np.delete(cells, end, axis=axis) for end in (0, -1)))
        total += (-1) ** sum(along) * int(cells.sum())
    return total


def ball(radius: float) -> tuple[Mask, FloatArray]:
    """The voxels of a ball, whose middle is between voxels, and the crossings of its sphere."""
    n = int(2 * radius) + 6
    at = np.moveaxis(np.indices((n, n, n)), 0, -1) - (n / 2 - 0.3)
    level = (at**2).sum(axis=-1) - radius**2
    crossings = np.full((3, n, n, n), 0.5)
    for axis in range(3):
        # The root in [0, 1] of |x + t e|² = r².
        here = at[..., axis]
        root = np.sqrt(np.maximum(here**2 - level, 0))
        crossings[axis] = np.where(level < 0, -here + root, -here - root)
    return level < 0, crossings


@pytest.mark.parametrize("share", [0.15, 0.5, 0.85])
def test_any_set_of_cells_has_a_closed_manifold_surface_that_crosses_where_it_must(
    share: float,
) -> None:
    """All 256 cubes are in random cells, beside any other."""
    rng = np.random.default_rng(0)
    body = np.pad(rng.random((14, 14, 14)) < share, 1)
    crossings = rng.uniform(0.02, 0.98, (3, *body.shape))
    mesh = surface(body, crossings)
    assert replace(defects(mesh), components=1) == SOUND
    assert mesh.euler_characteristic == 2 * digital_euler(body)
    n = 0
    for axis, at in enumerate(crossed(body)):
        expected = at + crossings[axis][tuple(at.T)][:, None] * np.eye(3)[axis]
        np.testing.assert_array_equal(mesh.vertices[n : n + len(at)], expected)
        n += len(at)
    assert mesh.volume > 0


def test_a_ball_converges_with_the_square_of_the_cell() -> None:
    errors = []
    for radius in (5.0, 10.0, 20.0):
        body, crossings = ball(radius)
        mesh = surface(body, crossings)
        assert not defects(mesh)
        errors.append(1 - mesh.volume / (4 / 3 * np.pi * radius**3))
    assert errors[-1] == pytest.approx(0, abs=2e-3)
    assert all(3 < coarse / fine < 5 for coarse, fine in pairwise(errors))


# --- smoothing ----------------------------------------------------------------------------------------

BALL = shapes.icosphere(4)
ROUGH: FloatArray = BALL.vertices * (
    1 + 0.01 * np.random.default_rng(0).standard_normal((len(BALL.vertices), 1))
)


def test_a_round_of_smoothing_moves_to_the_mean_of_the_neighbours_and_back() -> None:
    average = adjacency(BALL) / adjacency(BALL).sum(axis=1)[:, np.newaxis]
    expected = ROUGH
    for factor in (SHRINK, SWELL):
        expected = expected + factor * (average @ expected - expected)
    found = smoothed(ROUGH, BALL.faces, np.arange(len(ROUGH)), 1)
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_noise_goes_the_volume_stays_and_only_what_may_move_moves() -> None:
    moved = smoothed(ROUGH, BALL.faces, np.arange(len(ROUGH)), 8)
    assert (
        np.linalg.norm(moved, axis=1).std() < 0.45 * np.linalg.norm(ROUGH, axis=1).std()
    )
    assert TriangleMesh(moved, BALL.faces).volume == pytest.approx(BALL.volume, rel=0.002)
    above = np.flatnonzero(ROUGH[:, 2] > 0)
    changed = (smoothed(ROUGH, BALL.faces, above, 8) != ROUGH).any(axis=1)
    np.testing.assert_array_equal(np.flatnonzero(changed), above)
    # Near the mean of its neighbours.
    vertices = BALL.vertices.copy()
    vertices[0] *= 2
    moved = smoothed(vertices, BALL.faces, np.array([0]), 8)
    assert 1 < np.linalg.norm(moved[0]) < 1.15
