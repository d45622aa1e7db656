"""
The virtual scanner
===================

Samples and benchmarks are scanned by simulated depth cameras. Each view sees one side; together, armpits
and soles are still missing.
"""

import matplotlib.pyplot as plt
import numpy as np
from sample import person

from pcretrieve.simulation import RigOptions, scan_views

mesh = person(1, "stand")
options = RigOptions(n_views=6)
figure = plt.figure(figsize=(9, 6))
for number, view in enumerate(scan_views(mesh, options, np.random.default_rng(0)), start=1):
    axes = figure.add_subplot(
        2, 3, number, projection="3d", title=f"view {number}: {len(view.points)} points"
    )
    view.plot(axes)
    axes.set_axis_off()
