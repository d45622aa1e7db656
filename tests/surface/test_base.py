"""Bodies whose base was not seen, because they stood on it."""

from __future__ import annotations

import numpy as np
import pytest
import shapes

from pcretrieve import reconstruct
from pcretrieve.values import PointCloud

COARSE = {"surface": {"cell": 0.01, "target_faces": 3000, "reconstructions": 1}}


def test_an_unseen_base_is_closed_flat() -> None:
    """The ellipsoid x² / .36 + y² / .49 + z² = 1 above z = −.6."""
    points = shapes.points_on(shapes.ellipsoid((0.6, 0.7, 1.0)), 20_000)
    above = points[points[:, 2] > -0.6]
    surface = reconstruct(PointCloud(above, viewpoints=5 * above), COARSE)
    volume = np.pi * 0.6 * 0.7 * (1.6 - (1 + 0.6**3) / 3)
    assert surface.volume == pytest.approx(volume, rel=0.02)
