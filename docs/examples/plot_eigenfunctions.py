"""
Eigenfunctions of a body
========================

The eigenfunctions of the Laplace–Beltrami operator are the standing waves of the surface: the first ones
tell the head from the feet, and left from right; later ones are of single limbs.
"""

import matplotlib.pyplot as plt
from sample import draw, person

import pcretrieve as pr

mesh = person(1, "stand")
pairs = pr.eigenpairs(pr.laplace_beltrami(mesh), n_pairs=61)

functions = {f"number {number}": pairs.eigenvectors[:, number] for number in range(1, 5)}
draw(dict.fromkeys(functions, mesh), functions)

# %%
# By Weyl's law, the eigenvalues grow by 4π for each, once the surface is scaled to unit area.
plt.figure()
plt.plot(pairs.eigenvalues, "o-")
plt.ylabel("eigenvalue, length⁻²")
