"""
Touching limbs
==============

Hands on hips: Poisson reconstruction connects the surfaces, which makes handles. Region growing separates
them. The genus is half of two less the Euler characteristic.
"""

import matplotlib.pyplot as plt
from sample import SCANS

import pcretrieve as pr

path = SCANS / "person-1" / "person-1_hands_on_hips.ply"
figure = plt.figure(figsize=(9, 4.5))
for number, method in enumerate(["growth", "poisson"], start=1):
    surface = pr.reconstruct(path, {"surface": {"method": method}})
    genus = 1 - surface.euler_characteristic // 2
    axes = figure.add_subplot(1, 2, number, projection="3d", title=f"{method}: genus {genus}")
    surface.plot(axes)
    axes.view_init(20, -60, 180)  # the scanner had this body upside down
    axes.set_axis_off()
