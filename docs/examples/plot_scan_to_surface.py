"""
From a scan to a surface
========================

A raw scan has noise, outliers and holes. The stages remove outliers, orient the normals, and reconstruct a
closed surface.
"""

from sample import SCANS, draw

import pcretrieve as pr

scan = pr.read_scan(SCANS / "person-1" / "person-1_walk.ply")
surface = pr.reconstruct(scan)

draw({"scan": scan, "surface": surface})

# %%
# Each stage says what it did.
for step in surface.provenance:
    print(f"{step.stage}: {'; '.join(step.notes) or 'nothing to note'}")
