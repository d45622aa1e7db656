"""ShapeGoogle: a bag of features, with heat kernel signatures as the point descriptor.

The vocabulary is the same for every gallery: its words are the cluster centres (k-means from a fixed start)
of the point descriptors of some hundred points on simulated people, animals and hands, which are stored
beside this file and made by ``scripts/sample heat``. The signature of a shape therefore depends on this shape
alone, and signatures of different galleries are comparable. A vocabulary learned from the gallery would
quantise the gallery better, but change every signature with every shape that is added.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from pcretrieve.descriptors.descriptor import Descriptor, shipped
from pcretrieve.errors import OptionError
from pcretrieve.values import Eigenpairs, FloatArray, Signature

# Diffusion times on a surface of unit area, six as in ShapeGoogle. In time t heat spreads over a distance of
# about √(4 t): 0.09 for the first time, 0.9 for the last.
TIMES = np.geomspace(0.002, 0.2, 6)

# Scale-invariant heat kernel signature (Bronstein and Kokkinos): logarithms of the diffusion times, about a
# tenth of an octave apart, and the number of low frequencies of the derivative that are kept.
LOG_TIMES = np.linspace(np.log(0.001), np.log(1), 97)
N_FREQUENCIES = 6

# Diffusion time of the heat kernel that weighs pairs of words, on a surface of unit area.
SPATIAL_TIME = 0.02

# Added to the frequency of every word (additive smoothing): the distances compare logarithms of frequencies,
# in which a frequency of zero is not defined, and a very small one would outweigh all others.
SMALLEST_SHARE = 1e-3

SAMPLE = "hks_sample.npy"


def hks_bow(
    pairs: Eigenpairs, n_words: int = 23, *, spatial: bool = False, scale_invariant: bool = False
) -> Signature:
    """Bag of features of heat kernel signatures, with soft vector quantisation [1]_, sections 3 and 4.

    The weight θ_w(x) of word w at point x with descriptor p is proportional to exp(−‖p − w‖² / 2σ²), and
    Σ_w θ_w(x) = 1. σ is twice the median distance from a word to the nearest other word.

    pairs: of a connected surface on unit area, all of which are in the sum of the heat kernel.
    scale_invariant: take scale-invariant heat kernel signatures [2]_ as the point descriptor. Plain heat
        kernel signatures on unit area are invariant to the scale of the whole surface, but not to a local
        scale.
    Returns Signature: values : (L,) float64: ∫ θ_w / A + 0.001 for each word w, in the order of the
        vocabulary. With `spatial` (L (L + 1) / 2,) float64: ∬ θ_v(x) k(x, y) θ_w(y) dx dy + 0.001 on unit
        area, with the heat kernel k, for v ≤ w. Dimensionless, invariant to isometry and scaling.

    References
    ----------
    .. [1] A. Bronstein, M. Bronstein, L. Guibas and M. Ovsjanikov, "Shape Google: geometric words and
       expressions for invariant shape retrieval", ACM Transactions on Graphics 30 (2011).
    .. [2] M. Bronstein and I. Kokkinos, "Scale-invariant heat kernel signatures for non-rigid shape
       recognition", CVPR 2010.
    """
    vocabulary = _vocabulary(n_words, scale_invariant)
    features = heat_features(pairs, scale_invariant=scale_invariant)
    belongs = vocabulary.weights(features, 2 * vocabulary.gap)  # (n, L)
    in_modes = (pairs.mass @ pairs.eigenvectors).T @ belongs  # (m + 1, L): ∫ φ_k θ_w
    if spatial:
        heat = np.exp(-SPATIAL_TIME * pairs.eigenvalues)  # (m + 1,)
        shares = ((in_modes.T * heat) @ in_modes)[np.triu_indices(n_words)]  # (L (L + 1) / 2,)
    else:
        shares = in_modes[0]  # (L,): ∫ θ_w, since φ_0 = 1 on unit area
    kind = f"{'si-' * scale_invariant}hks-bow{'-spatial' * spatial}"
    # The heat kernel truncated at m modes may have small negative values.
    values = np.maximum(shares, 0) + SMALLEST_SHARE
    return Signature(values, kind=kind, digest=f"L={n_words} m={len(pairs.eigenvalues) - 1}")


def heat_features(pairs: Eigenpairs, *, scale_invariant: bool = False) -> FloatArray:
    """Heat kernel signatures of all vertices, h_t(x) = Σ_k exp(−λ_k t) φ_k(x)².

    pairs: eigenpairs of a surface of unit area with n vertices.
    Returns (n, 6) float64: dimensionless: log h_t(x) − log of the mean of h_t over the surface, at six
        diffusion times. With `scale_invariant` the magnitudes of the six lowest frequencies of the Fourier
        transform of ∂ log h / ∂ log t over log t: a scaling shifts this derivative along log t, which changes
        the phases alone.
    """
    if scale_invariant:
        return scale_invariant_heat(pairs, N_FREQUENCIES)
    decay = np.exp(-np.outer(pairs.eigenvalues, TIMES))  # (k, t)
    return np.asarray(np.log(pairs.eigenvectors**2 @ decay) - np.log(decay.sum(axis=0)))


def scale_invariant_heat(pairs: Eigenpairs, n_frequencies: int) -> FloatArray:
    """(n, f) scale-invariant heat kernel signatures, as by `heat_features`, the zero frequency first."""
    decay = np.exp(-np.outer(pairs.eigenvalues, np.exp(LOG_TIMES)))  # (k, t)
    slopes = np.diff(np.log(pairs.eigenvectors**2 @ decay), axis=1)  # (n, t - 1)
    return np.abs(np.fft.rfft(slopes, axis=1)[:, :n_frequencies])


@cache
def _vocabulary(n_words: int, scale_invariant: bool) -> Vocabulary:
    return clustered(shipped(SAMPLE)[int(scale_invariant)], n_words)  # of (s, 6)


def _bag(
    name: str, spread: float, *, spatial: bool = False, scale_invariant: bool = False
) -> Descriptor:
    return Descriptor(
        name=name,
        make=lambda shape, o: hks_bow(
            shape.eigenpairs, o.n_values, spatial=spatial, scale_invariant=scale_invariant
        ),
        needs=("eigenvectors",),
        has_size=False,
        length=lambda o: o.n_values * (o.n_values + 1) // 2 if spatial else o.n_values,
        spread=spread,
    )


HEAT_KERNEL_BAGS = (
    _bag("hks-bow", 0.60),
    _bag("hks-bow-spatial", 1.2, spatial=True),
    _bag("si-hks-bow", 0.83, scale_invariant=True),
    _bag("si-hks-bow-spatial", 1.3, spatial=True, scale_invariant=True),
)


# Smallest mean number of sample points for each cluster of k-means: with fewer points clusters become empty.
POINTS_PER_WORD = 8


class Vocabulary(NamedTuple):
    """The words (L, d) of a bag of features, and the median distance of a word to the nearest other one."""

    words: FloatArray
    gap: float

    def weights(self, features: FloatArray, width: float) -> FloatArray:
        """(n, L) soft assignment of point descriptors (n, d) to the words, with σ = `width`.

        It is proportional to exp(−‖p − w‖² / 2σ²) for point descriptor p and word w; each row sums to 1.
        """
        from scipy.spatial.distance import cdist

        squared = cdist(features, self.words, "sqeuclidean")  # (n, L)
        # Subtracting the smallest distance keeps the sum from underflowing to zero far from all words.
        nearness = np.exp(-(squared - squared.min(axis=1, keepdims=True)) / (2 * width**2))
        return np.asarray(nearness / nearness.sum(axis=1, keepdims=True))


def clustered(sample: FloatArray, n_words: int) -> Vocabulary:
    """The vocabulary of a sample (s, d) of point descriptors, by k-means from a fixed start."""
    from scipy.cluster.vq import kmeans2
    from scipy.spatial.distance import cdist

    most = len(sample) // POINTS_PER_WORD
    if not 2 <= n_words <= most:
        raise OptionError(
            f"n_values must be between 2 and {most} for a bag of words, got {n_words}"
        )
    start = np.random.default_rng(0).choice(len(sample), n_words, replace=False)
    words, _ = kmeans2(sample, sample[start], iter=50, minit="matrix")
    gaps = cdist(words, words)
    np.fill_diagonal(gaps, np.inf)
    return Vocabulary(words, float(np.median(gaps.min(axis=1))))
