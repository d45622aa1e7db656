"""Sparse codes of point descriptors by the atoms of a dictionary, and their pooling over a surface.

A point descriptor x is approximated by zᵀ D, with the atoms as the rows of D and few entries of z that are
not zero. The code z is that of 100 steps towards the minimiser of the lasso ½ ‖x − zᵀ D‖² + λ ‖z‖₁. Atoms of
heat kernel signatures are almost parallel, and between such atoms the minimiser is undecided until thousands
of steps later; rankings do not need it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pcretrieve.values import FloatArray

__all__ = ["N_ITERATIONS", "PENALTY", "SurfacePoints", "atom_shares", "sparse_codes"]

# λ of the lasso, for point descriptors and atoms of unit length. See docs/decisions.md, DL.
PENALTY = 0.1

# Steps of FISTA. See docs/decisions.md, DL.
N_ITERATIONS = 100


class SurfacePoints(NamedTuple):
    """Point descriptors of a surface.

    features: (n, d) float64, the point descriptors, of unit length.
    shares: (n,) float64, the share of the area of the surface that each point represents; the sum is 1.
    """

    features: FloatArray
    shares: FloatArray


def atom_shares(points: SurfacePoints, atoms: FloatArray) -> FloatArray:
    """How much of a surface each atom describes.

    atoms: (L, d) float64, the dictionary D.
    Returns (L,) float64: ``∫ |z_k| / Σ_l ∫ |z_l|`` for each atom k; not negative, of sum 1, dimensionless.
        All equal if every code is zero.
    """
    pooled = points.shares @ np.abs(sparse_codes(points.features, atoms))  # (L,): ∫ |z| / A
    total = pooled.sum()
    shares: FloatArray = pooled / total if total else np.full(len(atoms), 1 / len(atoms))
    return shares


def sparse_codes(features: FloatArray, atoms: FloatArray, n_iterations: int = N_ITERATIONS) -> FloatArray:
    """Codes z near the minimisers of ½ ‖x − zᵀ D‖² + λ ‖z‖₁ for point descriptors x, by FISTA [1]_.

    features: (n, d) float64, the point descriptors x, of unit length.
    atoms: (L, d) float64, the dictionary D, of rows of unit length.
    Returns (n, L) float64: the codes z, for λ = 0.1; most entries are zero.

    References
    ----------
    .. [1] A. Beck and M. Teboulle, "A fast iterative shrinkage-thresholding algorithm for linear inverse
       problems", SIAM Journal on Imaging Sciences 2 (2009), section 4.
    """
    gram = atoms @ atoms.T  # (L, L)
    correlation = features @ atoms.T  # (n, L)
    lipschitz = np.linalg.eigvalsh(gram)[-1]
    codes: FloatArray = np.zeros_like(correlation)
    ahead = codes
    momentum = 1.0
    for _ in range(n_iterations):
        moved = ahead - (ahead @ gram - correlation) / lipschitz
        after = moved - np.clip(moved, -PENALTY / lipschitz, PENALTY / lipschitz)  # soft threshold
        following = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
        ahead = after + (momentum - 1) / following * (after - codes)
        codes, momentum = after, following
    return codes
