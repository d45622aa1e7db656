"""
Removing the floor
==================

A scan that shows the floor around the body. The stage ``crop`` removes the floor before anything
else, and says by which rule.
"""

import numpy as np
from benchmarks.simulation import RigOptions, scan as simulated_scan
from sample import draw, person

import pcretrieve as pr

rng = np.random.default_rng(0)
body = simulated_scan(person(1, "stand"), RigOptions(n_points=9000), rng).points
upright = body[:, np.argsort(np.ptp(body, axis=0))]  # the longest extent is up
floor = np.column_stack([rng.uniform(-1, 1, (6000, 2)), np.zeros(6000)])
floor[:, :2] += upright[:, :2].mean(axis=0)
floor[:, 2] = upright[:, 2].min() + rng.normal(0, 0.002, len(floor))
scan = pr.PointCloud(np.concatenate([upright, floor]))

cropped = pr.crop(scan)
print(*cropped.provenance[-1].notes, sep="\n")
surface = pr.reconstruct(cropped)

heights = {"scan": scan.points[:, 2], "surface": surface.vertices[:, 2]}
draw({"scan": scan, "surface": surface}, heights)
