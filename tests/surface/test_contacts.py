"""Contact layers: parts of a body that touch are separated, and nothing else is."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from pcretrieve.points.grid import distances
from pcretrieve.surface.parts import DETOUR, contact_layer, walls

Mask = NDArray[np.bool_]
N = 30


def block() -> Mask:
    """A slab of voxels, whose shape does not show that it is folded."""
    inside = np.zeros((N, N, 12), dtype=bool)
    inside[3:-3, 3:-3, 3:-3] = True
    return inside


def fold(reach: int) -> Mask:
    """Links that cross the surfels of points half way up the block, `reach` voxels deep from its side."""
    x, z = np.meshgrid(np.arange(3, 3 + reach), np.arange(12), indexing="ij")
    points = np.column_stack([x.ravel(), np.full(x.size, N / 2), z.ravel()]).astype(float)
    return walls(points, np.tile([0.0, 1.0, 0.0], (len(points), 1)), block().shape)


def parted(inside: Mask, wall: Mask, continued: Mask | None = None) -> Mask:
    continued = np.zeros_like(wall) if continued is None else continued
    return contact_layer(inside, wall, continued, distances(~inside, np.inf))


def test_a_body_without_points_in_it_has_no_contacts() -> None:
    assert not parted(block(), np.zeros((3, *block().shape), dtype=bool)).any()


@pytest.mark.parametrize("reach", [10, 14, 18])
def test_a_fold_is_parted_in_one_layer_as_deep_as_it_goes(reach: int) -> None:
    found = parted(block(), fold(reach))
    layers = np.flatnonzero(found.any(axis=(0, 2)))
    assert len(layers) == 1
    assert abs(layers[0] - N / 2) <= 1
    # Near the end of the fold the detour is short, and the parts are not separated.
    depth = np.flatnonzero(found.any(axis=(1, 2))).max() - 2
    assert reach - DETOUR / 2 <= depth <= reach + 2
    legs, n = ndimage.label((block() & ~found)[3 : 3 + reach - DETOUR // 2])
    assert n == 2
    assert legs[0, 5, 6] != legs[0, -5, 6]
