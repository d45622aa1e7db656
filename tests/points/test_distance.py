"""Distances on a grid are those of an exact Euclidean distance transform, up to the limit."""

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from pcretrieve.points.grid import distances


@pytest.mark.parametrize("limit", [3.5, np.inf])
@pytest.mark.parametrize("shape", [(1, 9, 20), (23, 31, 17)])
@pytest.mark.parametrize("share", [0.002, 0.1])
def test_distances_are_exact_up_to_the_limit(limit: float, shape: tuple[int, int, int], share: float) -> None:
    sources = np.random.default_rng(0).random(shape) < share
    sources[0, 0, 0] = True
    expected = np.minimum(distance_transform_edt(~sources), limit).astype(np.float32)
    np.testing.assert_array_equal(distances(sources, limit), expected)


@pytest.mark.parametrize("limit", [7.0, np.inf])
def test_without_sources_every_voxel_is_at_the_limit(limit: float) -> None:
    assert (distances(np.zeros((3, 4, 5), dtype=bool), limit) == limit).all()
