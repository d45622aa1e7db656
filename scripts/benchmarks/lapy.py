"""LaPy, as functions of arrays: the library with which benchmarks compare the spectral core."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np

from pcretrieve.values import FloatArray, IntArray

__all__ = ["eigenvalues", "is_installed"]


def is_installed() -> bool:
    """Whether LaPy is installed, which the extra ``benchmark`` installs."""
    return find_spec("lapy") is not None


def eigenvalues(vertices: FloatArray, faces: IntArray, n_pairs: int) -> FloatArray:
    """The lowest eigenvalues of the Laplace–Beltrami operator by linear elements [1]_.

    vertices: (n, 3) float64, coordinates.
    faces: (m, 3) int32, vertex numbers.
    Returns (n_pairs,) float64: ascending; unit length⁻².

    References
    ----------
    .. [1] Reuter, Wolter and Peinecke, "Laplace–Beltrami spectra as 'Shape-DNA' of surfaces and solids",
       Computer-Aided Design 2006.
    """
    from lapy import Solver, TriaMesh

    values, _ = Solver(TriaMesh(vertices, faces)).eigs(n_pairs)
    return np.asarray(values, dtype=np.float64)
