"""Grids of voxels round a body, on which sets of voxels and distances are arrays.

In come points or a set of voxels; out go the grid, the voxels outside the body, which a flood fill reaches
from the border of the grid, the distances of all voxels to a set, and the components of a set.
"""

from pcretrieve.voxels.components import components
from pcretrieve.voxels.distance import distances
from pcretrieve.voxels.grid import Grid, Mask, Voxels
from pcretrieve.voxels.outside import FARTHEST, Outside, flood

__all__ = ["FARTHEST", "Grid", "Mask", "Outside", "Voxels", "components", "distances", "flood"]
