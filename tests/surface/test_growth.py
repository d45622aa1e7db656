"""Region growing: the region has the topology of a ball, few voxels are lost, and contacts are cut."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter, label

from pcretrieve.surface import defects
from pcretrieve.surface.growth import grown
from pcretrieve.surface.marching import marched
from pcretrieve.values import TriangleMesh

Mask = NDArray[np.bool_]


def blob(seed: int, n: int = 40) -> Mask:
    """Voxels in which smooth noise is above its mean: handles, cavities and several components."""
    noise = gaussian_filter(np.random.default_rng(seed).standard_normal((n, n, n)), 2.0)
    return np.pad(noise > 0, 1)


def ring(major: float, minor: float, n: int = 40) -> Mask:
    x, y, z = np.indices((n, n, n)) - (n - 1) / 2
    return np.asarray((np.hypot(x, y) - major) ** 2 + z**2 < minor**2)


def ball(radius: float, n: int = 40) -> Mask:
    return np.asarray(((np.indices((n, n, n)) - (n - 1) / 2) ** 2).sum(axis=0) < radius**2)


def cells(shape: tuple[int, int, int], *boxes: tuple[slice, slice, slice]) -> Mask:
    body = np.zeros(shape, dtype=bool)
    for box in boxes:
        body[box] = True
    return body


def depth(inside: Mask) -> NDArray[np.float32]:
    return np.asarray(distance_transform_edt(inside), dtype=np.float32)


def no_walls(inside: Mask) -> Mask:
    return np.zeros((3, *inside.shape), dtype=bool)


def euler(body: Mask) -> int:
    mesh = TriangleMesh(*marched(body))
    assert not defects(mesh)
    return mesh.euler_characteristic


@pytest.mark.parametrize(
    "inside", [*map(blob, range(6)), ring(12, 5), ring(8, 6), ring(15, 1.6)], ids=lambda inside: inside.sum()
)
def test_it_is_one_ball_inside_what_was_given(inside: Mask) -> None:
    body = grown(inside, depth(inside), no_walls(inside))
    assert not (body & ~inside).any()
    assert label(body)[1] == 1
    assert label(~body, np.ones((3, 3, 3)))[1] == 1
    assert euler(body) == 2


def test_a_ring_loses_one_slice_and_no_more() -> None:
    inside = ring(12, 5)
    cut = inside & ~grown(inside, depth(inside), no_walls(inside))
    assert 0 < cut.sum() < 2 * np.pi * 5**2  # two layers
    assert label(cut, np.ones((3, 3, 3)))[1] == 1
    at = np.argwhere(cut) - 19.5
    assert np.degrees(np.ptp(np.unwrap(np.arctan2(at[:, 1], at[:, 0])))) < 45


def test_bodies_of_genus_zero_are_not_changed() -> None:
    limbs = cells(
        (40, 40, 40),
        (slice(5, 35), slice(17, 23), slice(17, 23)),
        (slice(17, 23), slice(5, 35), slice(17, 23)),
        (slice(19, 20), slice(19, 20), slice(2, 38)),
    )
    for inside in (ball(17), ball(10) | limbs):
        np.testing.assert_array_equal(grown(inside, depth(inside), no_walls(inside)), inside)


@pytest.mark.parametrize("thickness", [4, 5, 6, 7])
def test_a_bar_of_constant_thickness_is_not_changed(thickness: int) -> None:
    """Many voxels have equal depths: their order must not leave tunnels."""
    inside = np.pad(np.ones((40, thickness, thickness), dtype=bool), 2)
    np.testing.assert_array_equal(grown(inside, depth(inside), no_walls(inside)), inside)


def test_the_deepest_piece_is_the_one_that_is_grown() -> None:
    inside = cells(
        (40, 20, 20), (slice(2, 38), slice(2, 5), slice(2, 18)), (slice(10, 20), slice(8, 18), slice(5, 15))
    )
    body = grown(inside, depth(inside), no_walls(inside))
    pieces, _ = label(inside)
    np.testing.assert_array_equal(body, pieces == pieces[15, 13, 10])


def test_bars_that_touch_are_cut_at_the_contact() -> None:
    """Two bars, connected by a thick block at one end and by a bridge one voxel thick at the other."""
    contact = (slice(40, 43), slice(10, 14), slice(6, 7))
    inside = cells(
        (48, 24, 13),
        (slice(2, 12), slice(2, 22), slice(2, 11)),
        (slice(12, 46), slice(2, 10), slice(2, 11)),
        (slice(12, 46), slice(14, 22), slice(2, 11)),
        contact,
    )
    assert euler(inside) == 0
    body = grown(inside, depth(inside), no_walls(inside))
    cut = inside & ~body
    assert cut.any()
    cut[contact] = False
    assert not cut.any()
    assert euler(body) == 2


@pytest.mark.parametrize("place", [14, 24, 34])
def test_walls_keep_apart_what_is_thickest_where_it_touches(place: int) -> None:
    """Two bars whose contact is twice as deep as they are: only the surfels between them show it."""
    block, low, high = (
        (slice(2, 6), slice(2, 17), slice(2, 9)),
        (slice(6, 42), slice(2, 9), slice(2, 9)),
        (slice(6, 42), slice(10, 17), slice(2, 9)),
    )
    inside = cells((44, 19, 11), block, low, high)
    inside[place : place + 6, 9, 2:9] = True
    assert euler(inside) == 0
    walls = no_walls(inside)
    walls[1, place : place + 6, 9] = True  # between the contact and the upper bar
    cut = inside & ~grown(inside, depth(inside), walls)
    assert cut.any()
    cut[place : place + 6, 9:11] = False
    assert not cut.any()
    unguided = inside & ~grown(inside, depth(inside), no_walls(inside))
    assert not unguided[place : place + 6].any()


def test_walls_take_nothing_off_a_ball() -> None:
    inside = ball(12)
    walls = no_walls(inside)
    walls[0, 15] = walls[2, :, :, 20] = True
    np.testing.assert_array_equal(grown(inside, depth(inside), walls), inside)


def test_the_answer_is_the_same_each_time_and_the_input_is_left_as_it_was() -> None:
    inside = blob(7)
    priority, walls = depth(inside), no_walls(inside)
    before = inside.copy(), priority.copy()
    first = grown(inside, priority, walls)
    np.testing.assert_array_equal(first, grown(inside, priority, walls))
    np.testing.assert_array_equal(inside, before[0])
    np.testing.assert_array_equal(priority, before[1])
    assert not walls.any()
