"""
Views with poses
================

A file in the format of Stanford lists the views of a turntable with their poses. Points of the nine views
are in one frame, each with the position of its sensor, from which the normals are oriented.
"""

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from sample import SCANS, draw

import pcretrieve as pr

cloud: Any = pr.read_scan(
    SCANS / "person-4" / "person-4_stand.conf"
)  # points, not a mesh
sensors, view = np.unique(cloud.viewpoints, axis=0, return_inverse=True)

draw(
    {"points by view": cloud, "surface": pr.reconstruct(cloud)},
    {"points by view": view.ravel()},
)

# %%
axes = plt.figure(figsize=(7, 6)).add_subplot(projection="3d")
axes.scatter(*cloud.points.T, c=view.ravel(), s=1, cmap="tab10")
axes.scatter(*sensors.T, c=range(len(sensors)), s=60, marker="^", cmap="tab10")
axes.set_aspect("equal")
axes.set_title(f"{len(sensors)} sensors and their points")
