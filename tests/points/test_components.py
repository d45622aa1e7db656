"""The components of a set of voxels are those that SciPy labels, with the same numbers."""

import numpy as np
import pytest
from scipy import ndimage

from pcretrieve.points.grid import components


@pytest.mark.parametrize("corners", [False, True])
@pytest.mark.parametrize("shape", [(1, 9, 30), (20, 31, 40)])
@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_components_are_those_of_scipy(shape: tuple[int, int, int], share: float, corners: bool) -> None:
    voxels = np.random.default_rng(0).random(shape) < share
    labels, sizes = components(voxels, corners)
    expected, n = ndimage.label(voxels, np.ones((3, 3, 3)) if corners else None)
    np.testing.assert_array_equal(labels, expected)
    np.testing.assert_array_equal(sizes, np.bincount(expected.ravel(), minlength=n + 1))
