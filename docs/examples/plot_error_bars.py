"""
Error bars
==========

The signature of a scan is the geometric mean over surfaces on voxel grids of different edges. How far these
differ is its error bar, here with four surfaces in place of two.
"""

from sample import SCANS, draw

import pcretrieve as pr

path = SCANS / "animal-1" / "animal-1_stand.ply"
options = {"surface": {"reconstructions": 4}, "signature": {"method": "r-bihdm"}}
shape = pr.process(path, options)
draw(
    {
        f"surface {number}": one.mesh
        for number, one in enumerate(shape.surfaces, start=1)
        if one.mesh
    }
)

# %%
pr.signature(path, options).plot()
