"""
Signatures of poses and of people
=================================

Two poses of one person have nearly the same signature; another person has another.
"""

import matplotlib.pyplot as plt
import numpy as np
from sample import person

import pcretrieve as pr

figure, (above, below) = plt.subplots(2, figsize=(8, 7), sharex=True)
standing = np.log(pr.signature(person(1, "stand"), "paper"))
for seed, pose in [(1, "stand"), (1, "walk"), (2, "stand"), (2, "walk")]:
    signature = pr.signature(person(seed, pose), "paper")
    above.semilogy(signature.values, label=f"person {seed}, {pose}")
    below.plot(np.log(signature) - standing, label=f"person {seed}, {pose}")
above.set_ylabel("R-BiHDM")
below.set_ylabel("difference of the logarithms")
below.set_xlabel("number of the value")
above.legend()
