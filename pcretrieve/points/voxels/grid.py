"""Grids of cubic voxels, and arrays with one value for each voxel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from pcretrieve.values import FloatArray

__all__ = ["Grid", "Mask", "Voxels"]

#: A set of voxels, or of other elements.
Mask: TypeAlias = NDArray[np.bool_]

#: A quantity in each voxel.
Voxels: TypeAlias = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """A grid of cubic voxels. The coordinates of a voxel are those of its centre.

    origin: (3,) float64, centre of voxel (0, 0, 0); unit of the file.
    cell: edge of a voxel; unit of the file.
    """

    origin: FloatArray
    cell: float
    shape: tuple[int, int, int]

    @classmethod
    def around(cls, points: FloatArray, cell: float, margin: int, shift: FloatArray | float = 0.0) -> Grid:
        """The smallest grid that contains points and a margin.

        points: (n, 3) float64, coordinates; unit of the file.
        cell: edge of a voxel; unit of the file.
        shift: (3,) float64 or float, default 0.0, displacement of the grid in the negative directions; in
            voxels.
        """
        low, high = points.min(axis=0) - np.asarray(shift) * cell, points.max(axis=0)
        n_x, n_y, n_z = (np.ceil((high - low) / cell).astype(int) + 2 * margin + 1).tolist()
        return cls(low - margin * cell, cell, (n_x, n_y, n_z))

    def coordinates(self, points: FloatArray) -> FloatArray:
        """(n, 3) coordinates of points in voxels, integer at the centres."""
        return (points - self.origin) / self.cell

    def index(self, points: FloatArray) -> tuple[NDArray[np.intp], ...]:
        """Indices, for an array of `shape`, of the voxels that contain the points."""
        return tuple(np.rint(self.coordinates(points)).astype(np.intp).T)
