"""
From a scan to a surface
========================

A raw scan has noise, outliers and holes. The stages remove outliers, orient the normals, and reconstruct a
closed surface.
"""

import matplotlib.pyplot as plt
from sample import SCANS

import pcretrieve as pr

scan = pr.read_scan(SCANS / "person-1" / "person-1_walk.ply")
surface = pr.reconstruct(scan)

figure = plt.figure(figsize=(9, 4.5))
scan.plot(figure.add_subplot(121, projection="3d", title="scan"))
surface.plot(figure.add_subplot(122, projection="3d", title="surface"))

# %%
# Each stage says what it did.
for step in surface.provenance:
    print(f"{step.stage}: {'; '.join(step.notes) or 'nothing to note'}")
