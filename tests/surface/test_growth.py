"""Regions grow to the topology of a ball, and parts that touch are separated; little else is lost."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter, label

from pcretrieve.points.grid import distances
from pcretrieve.surface import defects
from pcretrieve.surface.growth import grown
from pcretrieve.surface.marching import marched
from pcretrieve.surface.parts import DETOUR, contact_layer, walls as links_across
from pcretrieve.values import TriangleMesh

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
    body = grown(inside, depth, walls)
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
