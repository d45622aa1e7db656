"""
Distances between people in poses
=================================

Three people in four poses each. Blocks on the diagonal are the poses of one person: dark blocks and a
bright rest are what a search needs.
"""

import matplotlib.pyplot as plt
import numpy as np
from sample import person

import pcretrieve as pr

POSES = ["stand", "walk", "run", "wave"]
names = [f"{seed} {pose}" for seed in (1, 2, 3) for pose in POSES]
logarithms = np.array(
    [np.log(pr.signature(person(seed, pose), "paper")) for seed in (1, 2, 3) for pose in POSES]
)
distances = np.linalg.norm(logarithms[:, None] - logarithms[None], axis=-1)

axes = plt.figure(figsize=(7, 6)).add_subplot(title="distances of log-signatures")
plt.colorbar(axes.imshow(distances))
axes.set_xticks(range(len(names)), names, rotation=90)
axes.set_yticks(range(len(names)), names)
plt.tight_layout()
