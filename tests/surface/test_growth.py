"""Region growing: the region has the topology of a ball, few voxels are lost, and contacts are cut."""

from __future__ import annotations

import numpy as np
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


def depth(inside: Mask) -> NDArray[np.float32]:
    return np.asarray(distance_transform_edt(inside), dtype=np.float32)


def no_walls(inside: Mask) -> Mask:
    return np.zeros((3, *inside.shape), dtype=bool)


def euler(body: Mask) -> int:
    mesh = TriangleMesh(*marched(body))
    assert not defects(mesh)
    return mesh.euler_characteristic


def test_it_is_one_ball_inside_what_was_given() -> None:
    for inside in (*map(blob, range(2)), ring(12, 5)):
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


def test_walls_keep_apart_what_is_thickest_where_it_touches() -> None:
    """Two bars whose contact is twice as deep as they are: only the surfels between them show it."""
    inside, place = np.zeros((44, 19, 11), dtype=bool), 24
    inside[2:6, 2:17, 2:9] = inside[6:42, 2:9, 2:9] = inside[6:42, 10:17, 2:9] = True
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
