"""
Error bars
==========

The signature of a scan is the geometric mean over surfaces on voxel grids of different edges. How far these
differ is its error bar, here with four surfaces in place of two.
"""

from sample import SCANS

import pcretrieve as pr

path = SCANS / "animal-1" / "animal-1_stand.ply"
signature = pr.signature(path, {"surface": {"reconstructions": 4}, "signature": {"method": "r-bihdm"}})
signature.plot()
