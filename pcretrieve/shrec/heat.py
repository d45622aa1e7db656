"""Heat kernel signatures, compared by the words of a vocabulary or as sets of points.

ShapeGoogle describes a surface by a bag of features. The vocabulary of ``hks-bow`` is the same for every
gallery: its words are the cluster centres (k-means from a fixed start) of the point descriptors of some
hundred points on simulated people, animals and hands, which are stored beside this file and made by
``scripts/sample heat``. The signature of a shape therefore depends on this shape alone, and signatures of
different galleries are comparable. A vocabulary learned from the gallery would quantise the gallery better,
but change every signature with every shape that is added; the matcher ``hks-bow-gallery`` learns one.

By the modified Hausdorff distance [1]_, the matcher ``heat-hausdorff``, each surface is a weighted set of
points in the space of heat kernel signatures. The directed distance is the mean over one set of the distance
to the nearest point of the other; the distance is the larger of the two directed distances. No vector of a
single shape has such distances: which point is the nearest depends on both shapes.

References
----------
.. [1] M. Dubuisson and A. Jain, "A modified Hausdorff distance for object matching", ICPR 1994.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
from importlib import resources
from typing import NamedTuple

import numpy as np
from scipy.spatial.distance import cdist

from pcretrieve.descriptors.csd import scale_invariant_heat
from pcretrieve.descriptors.descriptor import Descriptor
from pcretrieve.errors import InputError, OptionError
from pcretrieve.spectral import unit_eigenpairs
from pcretrieve.values import Eigenpairs, FloatArray, Shape, Signature

# Diffusion times on a surface of unit area, six as in ShapeGoogle. In time t heat spreads over a distance of
# about √(4 t): 0.09 for the first time, 0.9 for the last.
TIMES = np.geomspace(0.002, 0.2, 6)

# Number of low frequencies of the scale-invariant heat kernel signature that are kept.
N_FREQUENCIES = 6

# Diffusion time of the heat kernel that weighs pairs of words, on a surface of unit area.
SPATIAL_TIME = 0.02

# Added to the frequency of every word (additive smoothing): the distances compare logarithms of frequencies,
# in which a frequency of zero is not defined, and a very small one would outweigh all others.
SMALLEST_SHARE = 1e-3

SAMPLE = "hks_sample.npy"


def hks_bow(
    pairs: Eigenpairs,
    n_words: int = 23,
    *,
    spatial: bool = False,
    scale_invariant: bool = False,
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
        shares = ((in_modes.T * heat) @ in_modes)[
            np.triu_indices(n_words)
        ]  # (L (L + 1) / 2,)
    else:
        shares = in_modes[0]  # (L,): ∫ θ_w, since φ_0 = 1 on unit area
    kind = f"{'si-' * scale_invariant}hks-bow{'-spatial' * spatial}"
    # The heat kernel truncated at m modes may have small negative values.
    values = np.maximum(shares, 0) + SMALLEST_SHARE
    return Signature(
        values, kind=kind, digest=f"L={n_words} m={len(pairs.eigenvalues) - 1}"
    )


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


HKS_BOW = _bag("hks-bow", 0.60)
HKS_BOW_SPATIAL = _bag("hks-bow-spatial", 1.2, spatial=True)
SI_HKS_BOW = _bag("si-hks-bow", 0.83, scale_invariant=True)
SI_HKS_BOW_SPATIAL = _bag("si-hks-bow-spatial", 1.3, spatial=True, scale_invariant=True)


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
        squared = cdist(features, self.words, "sqeuclidean")  # (n, L)
        # Subtracting the smallest distance keeps the sum from underflowing to zero far from all words.
        nearness = np.exp(
            -(squared - squared.min(axis=1, keepdims=True)) / (2 * width**2)
        )
        return np.asarray(nearness / nearness.sum(axis=1, keepdims=True))


def clustered(sample: FloatArray, n_words: int) -> Vocabulary:
    """The vocabulary of a sample (s, d) of point descriptors, by k-means from a fixed start."""
    from scipy.cluster.vq import kmeans2

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


@cache
def shipped(name: str) -> FloatArray:
    """An array that is stored beside this file, in double precision."""
    return np.asarray(
        np.load(str(resources.files(__package__).joinpath(name))), dtype=np.float64
    )


# --- pairs of surfaces ---------------------------------------------------------------------------------

# Number of eigenpairs in the heat kernel: 60 modes, as `hks_bow` has by default.
N_PAIRS = 61

# Number of points by which a surface is represented. See docs/decisions.md, N_SAMPLES.
N_SAMPLES = 300

# Words of the vocabulary, as published, and the points of each shape that they are the centres of.
N_WORDS = 48
N_POINTS = 100


class HeatPoints(NamedTuple):
    """Heat kernel signatures (p, 6) of points of a surface, and their shares (p,) of its area, of sum 1."""

    features: FloatArray
    shares: FloatArray


def _of_vertices(shape: Shape) -> tuple[FloatArray, FloatArray]:
    """The heat kernel signatures (n, 6) of the vertices of the first surface, and their areas (n,)."""
    pairs = unit_eigenpairs(shape.mesh, N_PAIRS)
    areas: FloatArray = np.asarray(pairs.mass.sum(axis=0), dtype=np.float64).ravel()
    return heat_features(pairs), areas


def heat_points(shape: Shape) -> HeatPoints:
    """The heat kernel signatures of all vertices of the first surface of a shape."""
    features, areas = _of_vertices(shape)
    return HeatPoints(features, areas / areas.sum())


def heat_set(shape: Shape) -> HeatPoints:
    """Signatures that represent those of all vertices: each is the farthest from those before it."""
    features, areas = _of_vertices(shape)
    nearest = np.zeros(len(features), dtype=np.intp)  # (n,): the nearest sample so far
    gaps = np.linalg.norm(features - areas @ features / areas.sum(), axis=1)  # (n,)
    samples: list[int] = []
    while len(samples) < min(N_SAMPLES, len(features)):
        farthest = int(gaps.argmax())
        apart = np.linalg.norm(features - features[farthest], axis=1)
        closer = apart < gaps if samples else np.ones(len(features), dtype=bool)
        nearest[closer], gaps[closer] = len(samples), apart[closer]
        samples.append(farthest)
    shares = np.bincount(nearest, weights=areas, minlength=len(samples)) / areas.sum()
    return HeatPoints(features[samples], shares)


def heat_distance(query: HeatPoints, other: HeatPoints) -> float:
    """The modified Hausdorff distance of two sets of heat kernel signatures."""
    apart = cdist(query.features, other.features)  # (s, t)
    return float(max(query.shares @ apart.min(axis=1), other.shares @ apart.min(axis=0)))


def word_frequencies(gallery: Sequence[HeatPoints]) -> Callable[[HeatPoints], FloatArray]:
    """Learn a vocabulary from a gallery [1]_, sections 3 and 4.

    The open settings, and deviations from the article: 48 words, which are the cluster centres (k-means from
    a fixed start) of random points of the gallery, drawn in proportion to area; soft assignment with σ twice
    the median gap between neighbouring words.

    Returns function of HeatPoints that returns (48,) float64: the share of the area of a surface that each
        word has, of sum 1. It can be pickled.

    References
    ----------
    .. [1] A. Bronstein, M. Bronstein, L. Guibas and M. Ovsjanikov, "Shape Google: geometric words and
       expressions for invariant shape retrieval", ACM Transactions on Graphics 30 (2011).
    """
    rng = np.random.default_rng(0)
    fewest = N_WORDS * POINTS_PER_WORD
    # Small galleries give more points of each shape.
    number = max(N_POINTS, -(-fewest // len(gallery)))
    sample = np.concatenate(
        [
            features[
                rng.choice(len(shares), min(number, len(shares)), replace=False, p=shares)
            ]
            for features, shares in gallery
        ]
    )  # (s, 6)
    if len(sample) < fewest:
        raise InputError(
            f"a vocabulary of {N_WORDS} words needs a gallery of at least {fewest} vertices, got "
            f"{len(sample)}: add shapes, or use the descriptor hks-bow"
        )
    return partial(_frequencies, clustered(sample, N_WORDS))


def _frequencies(vocabulary: Vocabulary, points: HeatPoints) -> FloatArray:
    """(48,) shares of the area of a surface that the words have."""
    return points.shares @ vocabulary.weights(points.features, 2 * vocabulary.gap)
