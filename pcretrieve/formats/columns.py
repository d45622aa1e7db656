"""The columns of a file that stores a point cloud as a table."""

from __future__ import annotations

import numpy as np

from pcretrieve.arrays import FloatArray
from pcretrieve.values import PointCloud

__all__ = ["columns_of"]


def columns_of(cloud: PointCloud, points: str, normals: str, viewpoints: str) -> tuple[list[str], FloatArray]:
    """The arrays of a cloud as one table.

    Returns table : (n, c) float64: the columns; unit of the cloud.
    """
    arrays = ((points, cloud.points), (normals, cloud.normals), (viewpoints, cloud.viewpoints))
    held = [(names, array) for names, array in arrays if array is not None]
    return " ".join(names for names, _ in held).split(), np.concatenate([array for _, array in held], axis=1)
