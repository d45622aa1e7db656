"""
Distances between people in poses
=================================

Three people in four poses each. Blocks on the diagonal are the poses of one person: dark blocks and a
bright rest are what a search needs.
"""

import matplotlib.pyplot as plt
import numpy as np
from sample import draw, person

import pcretrieve as pr

POSES = ["stand", "walk", "run", "wave"]
people = {f"{seed} {pose}": person(seed, pose) for seed in (1, 2, 3) for pose in POSES}
draw({name: people[name] for name in ("1 stand", "1 run", "2 wave", "3 walk")})

# %%
logarithms = np.array([np.log(pr.signature(body, "paper")) for body in people.values()])
distances = np.linalg.norm(logarithms[:, None] - logarithms[None], axis=-1)

axes = plt.figure(figsize=(7, 6)).add_subplot(title="distances of log-signatures")
plt.colorbar(axes.imshow(distances))
axes.set_xticks(range(len(people)), people, rotation=90)
axes.set_yticks(range(len(people)), people)
plt.tight_layout()
