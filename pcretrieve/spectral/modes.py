"""Surface → lowest eigenpairs at unit area."""

from __future__ import annotations

import numpy as np

from pcretrieve.spectral.eigen import eigenpairs
from pcretrieve.spectral.operators import laplace_beltrami
from pcretrieve.values import Eigenpairs, TriangleMesh

__all__ = ["unit_eigenpairs"]


def unit_eigenpairs(mesh: TriangleMesh, n_pairs: int, element: str = "linear") -> Eigenpairs:
    """The lowest eigenpairs of a surface scaled to unit area, as all descriptors take them.

    At unit area tolerances mean the same for every surface: the matrix of R-BiHDM scales as length⁴.

    mesh: in any unit and place.
    """
    vertices = (mesh.vertices - mesh.vertices.mean(axis=0)) / np.sqrt(mesh.area)
    return eigenpairs(laplace_beltrami(TriangleMesh(vertices, mesh.faces), element), n_pairs)
