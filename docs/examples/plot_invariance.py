"""
Signatures of poses and of people
=================================

Two poses of one person have nearly the same signature; another person has another.
"""

import matplotlib.pyplot as plt
import numpy as np
from sample import draw, person

import pcretrieve as pr

people = {
    f"person {seed}, {pose}": person(seed, pose)
    for seed in (1, 2)
    for pose in ("stand", "walk")
}
draw(people)

# %%
figure, (above, below) = plt.subplots(2, figsize=(8, 7), sharex=True)
standing = np.log(pr.signature(people["person 1, stand"], "paper"))
for name, body in people.items():
    signature = pr.signature(body, "paper")
    above.semilogy(signature.values, label=name)
    below.plot(np.log(signature) - standing, label=name)
above.set_ylabel("R-BiHDM")
below.set_ylabel("difference of the logarithms")
below.set_xlabel("number of the value")
above.legend()
