"""
Whitening
=========

Three people in four poses, before and after a whitening that was fitted to three other people. It gives
less weight to the directions in which a body differs from itself.
"""

import matplotlib.pyplot as plt
import numpy as np
from sample import draw, person

import pcretrieve as pr

POSES = ["stand", "walk", "run", "wave"]


def logarithms(seeds: tuple[int, ...]) -> np.ndarray:
    """One log-signature in each row, poses of a person after each other."""
    return np.array(
        [
            np.log(pr.signature(person(seed, pose), "paper"))
            for seed in seeds
            for pose in POSES
        ]
    )


draw({f"person {seed}": person(seed, "wave") for seed in (1, 2, 3)})

# %%
known, asked = logarithms((4, 5, 6)), logarithms((1, 2, 3))
whitening = pr.WithinClassWhitening().fit(known, np.repeat([4, 5, 6], len(POSES)))

figure, panels = plt.subplots(1, 2, figsize=(10, 4.5))
for axes, rows in zip(panels, (asked, whitening.transform(asked)), strict=True):
    distances = np.linalg.norm(rows[:, None] - rows[None], axis=-1)
    axes.imshow(distances)
panels[0].set_title("without")
panels[1].set_title("whitened")
