"""
Touching limbs
==============

Hands on hips: Poisson reconstruction connects the surfaces, which makes handles. Region growing separates
them. The genus is half of two less the Euler characteristic.
"""

from sample import SCANS, draw

import pcretrieve as pr

path = SCANS / "person-1" / "person-1_hands_on_hips.ply"
bodies = {}
for method in ("growth", "poisson"):
    surface = pr.reconstruct(path, {"surface": {"method": method}})
    genus = 1 - surface.euler_characteristic // 2
    bodies[f"{method}: genus {genus}"] = surface

draw(bodies)
