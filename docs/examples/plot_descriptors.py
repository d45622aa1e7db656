"""
Descriptors
===========

Several descriptors of the same two bodies. What is alike in both columns does not tell them apart.
"""

import matplotlib.pyplot as plt
from sample import person

import pcretrieve as pr

METHODS = ["r-bihdm", "shape-dna", "csd", "wks"]
figure, rows = plt.subplots(2, 2, figsize=(9, 6))
for axes, method in zip(rows.flat, METHODS, strict=True):
    for seed in (1, 2):
        signature = pr.signature(person(seed, "stand"), {"signature": {"method": method, "n_values": 40}})
        axes.plot(signature.values, label=f"person {seed}")
    axes.set_title(method)
    axes.set_yscale("log")
rows[0, 0].legend()
figure.tight_layout()
