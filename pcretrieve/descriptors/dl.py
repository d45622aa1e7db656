"""Bags of sparse codes: point descriptors as sparse combinations of the atoms of a learned dictionary.

Litman et al. learn the dictionary from the shapes of a set, without labels or with labels. Here both
dictionaries are learned from simulated people, animals and hands, are stored beside this file, and are made
by ``scripts/sample dictionary``: the signature of a shape depends on this shape alone, and signatures of
different galleries are comparable.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from pcretrieve.descriptors.bags import scale_invariant_heat
from pcretrieve.descriptors.descriptor import Descriptor, shipped
from pcretrieve.values import Eigenpairs, FloatArray, Signature

# Number of atoms, as published, and of frequencies of the point descriptor.
N_ATOMS = 32
N_FREQUENCIES = 19

# λ of the lasso, for point descriptors and atoms of unit length.
PENALTY = 0.1

# Steps of FISTA.
N_ITERATIONS = 100

ATOMS = "dl_atoms.npy"


class SurfacePoints(NamedTuple):
    """Point descriptors (n, d) of unit length, and their shares (n,) of the area of the surface, of sum 1."""

    features: FloatArray
    shares: FloatArray


def dl(pairs: Eigenpairs, *, supervised: bool = False) -> Signature:
    """The mean absolute sparse code of a surface [1]_.

    The open settings, and deviations from the article: scale-invariant heat kernel signatures of unit length,
    of 19 frequencies, as the point descriptor; λ = 0.1; codes after 100 steps of FISTA; dictionaries that are
    learned from simulated bodies instead of the gallery, the supervised one with individuals as classes and a
    margin of 0.3 of the gap between classes; and the Hellinger distance of the shares of the atoms instead of
    the Euclidean distance of the means, in the loss of the supervised dictionary too.

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
    """The scale-invariant heat kernel signatures of all vertices, scaled to unit length."""
    features = scale_invariant_heat(pairs, N_FREQUENCIES)  # (n, 19)
    areas = np.asarray(pairs.mass.sum(axis=0)).ravel()  # (n,)
    lengths = np.linalg.norm(features, axis=1, keepdims=True)
    unit = features / np.maximum(lengths, np.finfo(float).tiny)
    return SurfacePoints(unit, areas / areas.sum())


@cache
def _atoms() -> FloatArray:
    """(2, 32, 19): the dictionary that was learned without labels, and the one with labels."""
    return shipped(ATOMS)


def atom_shares(points: SurfacePoints, atoms: FloatArray) -> FloatArray:
    """(L,) shares of the atoms, ``∫ |z_k| / Σ_l ∫ |z_l|`` for codes z; equal if every code is zero."""
    pooled = points.shares @ np.abs(sparse_codes(points.features, atoms))  # (L,): ∫ |z| / A
    total = pooled.sum()
    return np.asarray(pooled / total if total else np.full(len(atoms), 1 / len(atoms)))


def sparse_codes(features: FloatArray, atoms: FloatArray, n_iterations: int = N_ITERATIONS) -> FloatArray:
    """(n, L) codes z near the minimisers of ½ ‖x − zᵀ D‖² + λ ‖z‖₁, most entries of which are zero.

    By FISTA (Beck and Teboulle, SIAM Journal on Imaging Sciences 2, 2009, section 4), for point descriptors x
    (n, d) and the dictionary D (L, d), of rows of unit length.
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
