"""
Descriptors
===========

Several descriptors of the same two bodies. What is alike in both columns does not tell them apart.
"""

import matplotlib.pyplot as plt
from sample import draw, person

import pcretrieve as pr

METHODS = ["r-bihdm", "shape-dna", "csd", "wks"]
people = {f"person {seed}": person(seed, "stand") for seed in (1, 2)}
draw(people)

# %%
figure, rows = plt.subplots(2, 2, figsize=(9, 6))
for axes, method in zip(rows.flat, METHODS, strict=True):
    for name, body in people.items():
        signature = pr.signature(body, {"signature": {"method": method, "n_values": 40}})
        axes.plot(signature.values, label=name)
    axes.set_title(method)
    axes.set_yscale("log")
rows[0, 0].legend()
figure.tight_layout()
