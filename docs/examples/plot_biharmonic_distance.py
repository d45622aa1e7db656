"""
The biharmonic distance
=======================

The distance from one point, here a vertex at the end of the body, from the first sixty eigenpairs. R-BiHDM
is the spectrum of this distance as an integral operator.
"""

import matplotlib.pyplot as plt
import numpy as np
from sample import draw_function, person

import pcretrieve as pr

figure = plt.figure(figsize=(9, 4.5))
for number, pose in enumerate(["stand", "walk"], start=1):
    mesh = person(1, pose)
    pairs = pr.eigenpairs(pr.laplace_beltrami(mesh), n_pairs=61)
    coordinates = pairs.eigenvectors[:, 1:] / pairs.eigenvalues[1:]  # (n, 60): the embedding of the distance
    distances = np.linalg.norm(coordinates - coordinates[0], axis=1)
    axes = figure.add_subplot(1, 2, number, projection="3d", title=f"{pose}: up to {distances.max():.3g}")
    draw_function(axes, mesh, distances)
