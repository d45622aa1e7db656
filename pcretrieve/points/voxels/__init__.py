"""Grids of voxels round a body, on which sets of voxels and distances are arrays.

In come points, a surface or a set of voxels; out go the grid, the voxels outside a body, which a flood fill
reaches from the border of the grid, the voxels inside a surface, the distances of all voxels to a set, and
the components of a set.
"""

from pcretrieve.points.voxels.components import components
from pcretrieve.points.voxels.distance import distances
from pcretrieve.points.voxels.grid import Grid, Mask, Voxels
from pcretrieve.points.voxels.interior import interior
from pcretrieve.points.voxels.outside import FARTHEST, Outside, flood, sampled

__all__ = [
    "FARTHEST",
    "Grid",
    "Mask",
    "Outside",
    "Voxels",
    "components",
    "distances",
    "flood",
    "interior",
    "sampled",
]
