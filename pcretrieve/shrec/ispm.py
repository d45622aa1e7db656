"""ISPM: intrinsic spatial pyramid matching, with spectral graph wavelet signatures as the point descriptor.

The second eigenfunction φ_1 of the Laplace–Beltrami operator varies along the longest direction of a surface.
Its level sets cut the surface into 1, 2, 4 and 8 parts of equal area, and each part has a bag of features of
its own, so that words count as alike only if they are in corresponding parts.

The sign of φ_1 is arbitrary, and with the other sign the parts are in reverse order. Li and Ben Hamza compare
two surfaces twice, in the one and in the other order, and take the smaller distance. Here the frequencies of
a word in two parts that the other sign would exchange are sorted, the larger first: the values then do not
depend on the sign, one vector describes a surface, and every index, whitening and file of pcretrieve takes it
as it takes others. Since sorting chooses the better order for each pair of parts and each word, the distance
is at most the smaller one of the two.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from pcretrieve.descriptors.descriptor import Descriptor, check_modes
from pcretrieve.shrec.heat import Vocabulary, clustered, shipped
from pcretrieve.values import Eigenpairs, FloatArray, Signature, unit_vectors

# Number of levels of the pyramid: 1, 2, 4 and 8 parts, which have one weight.
N_LEVELS = 4

# Ratio of the largest eigenvalue to the scale of the scaling function (Hammond et al., section 8.1).
EIGENVALUE_RATIO = 20.0

# Largest value of the wavelet kernel, at x = 2 − 1/√3, to which the scaling function is scaled.
KERNEL_MAXIMUM = 1 + 2 / (3 * np.sqrt(3))

SAMPLE = "wavelet_sample.npy"


def ispm(pairs: Eigenpairs, n_words: int = 59, n_modes: int = 60) -> Signature:
    """Intrinsic spatial pyramid matching of spectral graph wavelet signatures [1]_.

    The open settings, and deviations from the article: 60 eigenpairs instead of 200, which meshes of 500
    faces do not have; words from simulated bodies instead of the gallery; σ of the soft assignment as large
    as the median gap between neighbouring words; levels of 1, 2, 4 and 8 parts, with equal weights; parts of
    equal area instead of equal numbers of vertices, so that they do not depend on the mesh; and the Hellinger
    distance, the distance of the square roots of the frequencies.

    pairs: at least `n_modes` + 1 eigenpairs of a connected surface on unit area.
    Returns Signature: values : (15 W,) float64, to be compared as ``histograms``: a quarter of the share of
        the area of the surface that each word has in each part, the levels from coarse to fine. Of two parts
        that the other sign of φ_1 would exchange, the larger share of each word is with the first part. Not
        negative, of sum 1, dimensionless; invariant to isometry and scaling if λ_1 is a simple eigenvalue.

    References
    ----------
    .. [1] C. Li and A. Ben Hamza, "Intrinsic spatial pyramid matching for deformable 3D shape retrieval",
       International Journal of Multimedia Information Retrieval 2 (2013).
    """
    vocabulary = _vocabulary(n_words)
    belongs = vocabulary.weights(
        wavelet_signatures(pairs, n_modes), vocabulary.gap
    )  # (n, W)
    shares = _parts(pairs, 2 ** (N_LEVELS - 1)) @ belongs  # (8, W)
    levels = [_sorted_pairs(shares).ravel()]
    while len(shares) > 1:
        shares = shares[::2] + shares[1::2]
        levels.append(_sorted_pairs(shares).ravel())
    values = np.concatenate(levels[::-1]) / N_LEVELS
    return Signature(
        values, kind="ispm", digest=f"L={n_words} m={n_modes}", metric="histograms"
    )


def wavelet_signatures(pairs: Eigenpairs, n_modes: int = 60) -> FloatArray:
    """Spectral graph wavelet signatures of all vertices, Σ_k g(t λ_k) φ_k(x)² [1]_.

    pairs: at least `n_modes` + 1 eigenpairs of a surface of unit area with n vertices.
    Returns (n, 3) float64: one value for the scaling function and for each of two wavelets, with the cubic
        spline kernel of Hammond et al. [2]_, section 8.1, and λ_m as the largest eigenvalue. Dimensionless,
        of unit length at each vertex.

    References
    ----------
    .. [1] C. Li and A. Ben Hamza, "A multiresolution descriptor for deformable 3D shape retrieval", The
       Visual Computer 29 (2013).
    .. [2] D. Hammond, P. Vandergheynst and R. Gribonval, "Wavelets on graphs via spectral graph theory",
       Applied and Computational Harmonic Analysis 30 (2011).
    """
    check_modes(n_modes, len(pairs.eigenvalues), least=2)
    lowest = pairs.lowest(n_modes + 1)
    lam = lowest.eigenvalues  # (m + 1,)
    largest, smallest = lam[-1], lam[-1] / EIGENVALUE_RATIO
    scaling = KERNEL_MAXIMUM * np.exp(-((lam / (0.6 * smallest)) ** 4))
    kernels = np.array(
        [scaling, _spline(2 / smallest * lam), _spline(lam / largest)]
    )  # (3, m + 1)
    return unit_vectors(lowest.eigenvectors**2 @ kernels.T)  # (n, 3)


def _spline(x: FloatArray) -> FloatArray:
    """The wavelet kernel g: x² up to 1, 4 / x² from 2 on, and between them a cubic polynomial."""
    between = -5 + 11 * x - 6 * x**2 + x**3
    return np.where(x < 1, x**2, np.where(x > 2, 4 / np.maximum(x, 1) ** 2, between))


def _parts(pairs: Eigenpairs, n_parts: int) -> FloatArray:
    """(n_parts, n) areas of the vertices in parts of equal area along φ_1; a vertex may be in two parts."""
    areas = np.asarray(pairs.mass.sum(axis=0)).ravel()  # (n,)
    order = np.argsort(pairs.eigenvectors[:, 1], kind="stable")
    after = np.empty_like(areas)
    after[order] = np.cumsum(areas[order])
    before = after - areas
    cuts = np.linspace(0, after[order[-1]], n_parts + 1)[
        :, np.newaxis
    ]  # (n_parts + 1, 1)
    return np.asarray(
        np.clip(after, cuts[:-1], cuts[1:]) - np.clip(before, cuts[:-1], cuts[1:])
    )


def _sorted_pairs(shares: FloatArray) -> FloatArray:
    """The shares (p, W) of words in parts, sorted in each pair of parts that the sign of φ_1 exchanges."""
    half = len(shares) // 2
    if not half:
        return shares
    first, mirrored = shares[:half], shares[: half - 1 : -1]
    return np.concatenate([np.maximum(first, mirrored), np.minimum(first, mirrored)])


@cache
def _vocabulary(n_words: int) -> Vocabulary:
    return clustered(shipped(SAMPLE), n_words)  # of (s, 3)


ISPM = Descriptor(
    name="ispm",
    make=lambda shape, o: ispm(shape.eigenpairs, o.n_values, o.n_modes),
    needs=("eigenvectors",),
    has_size=False,
    length=lambda o: (2**N_LEVELS - 1) * o.n_values,
    metric="histograms",
    spread=0.28,
)
