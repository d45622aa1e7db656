"""
The biharmonic distance
=======================

The distance from one point, here a vertex at the end of the body, from the first sixty eigenpairs. R-BiHDM
is the spectrum of this distance as an integral operator.
"""

import numpy as np
from sample import draw, person

import pcretrieve as pr

bodies, functions = {}, {}
for pose in ("stand", "walk"):
    mesh = person(1, pose)
    pairs = pr.eigenpairs(pr.laplace_beltrami(mesh), n_pairs=61)
    coordinates = (
        pairs.eigenvectors[:, 1:] / pairs.eigenvalues[1:]
    )  # (n, 60): the embedding of the distance
    distances = np.linalg.norm(coordinates - coordinates[0], axis=1)
    name = f"{pose}: up to {distances.max():.3g}"
    bodies[name], functions[name] = mesh, distances

draw(bodies, functions)
