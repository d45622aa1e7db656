"""Taubin smoothing of a part of a surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pcretrieve.values import FloatArray, IntArray

__all__ = ["smoothed"]

# The factors λ > 0 and μ < −λ of Taubin's filter: a low-pass filter without shrinkage.
SHRINK, SWELL = 0.5, -0.53


def smoothed(vertices: FloatArray, faces: IntArray, moving: NDArray[np.intp], n_rounds: int) -> FloatArray:
    """Smooth some vertices of a surface by Taubin's filter [1]_.

    vertices: (n, 3) float64, coordinates of all vertices, in any unit.
    faces: (m, 3) int32, vertex numbers of each face.
    moving: (k,) int, the vertices that are smoothed; the others are fixed.
    Returns (n, 3) float64: coordinates of all vertices, in the unit of the input.

    References
    ----------
    .. [1] Taubin, "A signal processing approach to fair surface design", SIGGRAPH 1995.
    """
    from scipy.sparse import csr_array

    if not len(moving):
        return vertices
    n = len(vertices)
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])  # (3m, 2)
    near = csr_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(n, n))
    near = (near + near.T)[moving]  # (k, n)
    near.data[:] = 1
    weights = 1 / near.sum(axis=1)[:, None]
    result = vertices.copy()
    for _ in range(n_rounds):
        for factor in (SHRINK, SWELL):
            result[moving] += factor * (weights * (near @ result) - result[moving])
    return np.asarray(result)
