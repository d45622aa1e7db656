"""
Elements on a sphere
====================

The eigenvalues of the unit sphere are l (l + 1), each 2 l + 1 times. The errors of linear elements fall
with the square of the edge. Cubic elements leave little but the error of flat faces in place of a round
surface, which falls with the square of the edge too.
"""

import matplotlib.pyplot as plt
import numpy as np
from sample import draw, sphere

import pcretrieve as pr

exact = np.repeat(np.arange(7) * np.arange(1, 8), 2 * np.arange(7) + 1)  # 49 values
meshes = [sphere(rounds) for rounds in (2, 3, 4)]
spheres = {f"{len(mesh.faces)} faces": mesh for mesh in meshes}
draw(
    spheres,
    {name: mesh.vertices[:, 0] * mesh.vertices[:, 1] for name, mesh in spheres.items()},
)

# %%
# The largest error of 48 eigenvalues.
axes = plt.figure(figsize=(7, 5)).add_subplot()
for element in ("linear", "cubic"):
    errors = []
    for mesh in meshes:
        pairs = pr.eigenpairs(pr.laplace_beltrami(mesh, element), n_pairs=len(exact))
        scaled = (
            pairs.eigenvalues * mesh.area / (4 * np.pi)
        )  # of the sphere with the area of the mesh
        errors.append(np.abs(scaled[1:] / exact[1:] - 1).max())
    axes.loglog([len(mesh.faces) for mesh in meshes], errors, marker="o", label=element)
axes.set_xlabel("faces")
axes.set_ylabel("relative error")
axes.legend()
