"""Bags of sparse codes: point descriptors as sparse combinations of the atoms of a learned dictionary.

Litman et al. learn the dictionary from the shapes of a set, without labels or with labels. Here both
dictionaries are learned from simulated people, animals and hands, are stored beside this file, and are made
by ``scripts/sample_dictionary``: the signature of a shape depends on this shape alone, and signatures of
different galleries are comparable. Dictionaries of other shapes are learned by
`sparse_dictionary` and `supervised_dictionary` of ``scripts/benchmarks/shipped.py``.
"""

from __future__ import annotations

from functools import cache
from importlib import resources
from typing import NamedTuple

import numpy as np

from pcretrieve.descriptors.bags import scale_invariant_heat
from pcretrieve.descriptors.descriptor import Descriptor
from pcretrieve.values import Eigenpairs, FloatArray, Signature

# Number of atoms, as published, and of frequencies of the point descriptor.
N_ATOMS = 32
N_FREQUENCIES = 19

ATOMS = "dl_atoms.npy"


def dl(pairs: Eigenpairs, *, supervised: bool = False) -> Signature:
    """The mean absolute sparse code of a surface [1]_.

    The open settings, and deviations from the article: scale-invariant heat
    kernel signatures of unit length, of 19 frequencies, as the point descriptor; λ = 0.1; codes after 100
    steps of FISTA; dictionaries that are learned from simulated bodies instead of the gallery, the supervised
    one with individuals as classes and a margin of 0.3 of the gap between classes; and the Hellinger distance
    of the shares of the atoms instead of the Euclidean distance of the means, in the loss of the supervised
    dictionary too.

    pairs: of a connected surface on unit area, all of which are in the sum of the heat kernel.

    References
    ----------
    .. [1] R. Litman, A. Bronstein, M. Bronstein and U. Castellani, "Supervised learning of bag-of-features
       shape descriptors using sparse coding", Computer Graphics Forum 33 (2014).
    """
    shares = atom_shares(surface_points(pairs), _atoms()[int(supervised)])
    kind = "dl-supervised" if supervised else "dl"
    return Signature(shares, kind=kind, digest=f"m={len(pairs.eigenvalues) - 1}", metric="histograms")


def surface_points(pairs: Eigenpairs) -> SurfacePoints:
    """The point descriptors of all vertices of a surface.

    pairs: of a connected surface on unit area.
    Returns SurfacePoints: features : (n, 19) float64, scale-invariant heat kernel signatures, scaled to unit
        length.
    """
    features = scale_invariant_heat(pairs, N_FREQUENCIES)  # (n, 19)
    areas = np.asarray(pairs.mass.sum(axis=0)).ravel()  # (n,)
    lengths = np.linalg.norm(features, axis=1, keepdims=True)
    unit = features / np.maximum(lengths, np.finfo(float).tiny)
    return SurfacePoints(unit, areas / areas.sum())


@cache
def _atoms() -> FloatArray:
    """(2, 32, 19): the dictionary that was learned without labels, and the one with labels."""
    stored = np.load(str(resources.files(__package__).joinpath(ATOMS)))
    return np.asarray(stored, dtype=np.float64)


def _record(name: str, spread: float, *, supervised: bool) -> Descriptor:
    return Descriptor(
        name=name,
        make=lambda shape, _: dl(shape.eigenpairs, supervised=supervised),
        needs=("eigenvectors",),
        has_size=False,
        length=lambda _: N_ATOMS,
        metric="histograms",
        spread=spread,
    )


DL = _record("dl", 0.065, supervised=False)
DL_SUPERVISED = _record("dl-supervised", 0.067, supervised=True)


# λ of the lasso, for point descriptors and atoms of unit length.
PENALTY = 0.1

# Steps of FISTA.
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
