"""Vocabularies of bags of features: cluster centres of point descriptors, and soft assignment to them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.cluster.vq import kmeans2
from scipy.spatial.distance import cdist

from pcretrieve.errors import OptionError
from pcretrieve.values import FloatArray

__all__ = ["Vocabulary", "clustered"]

# Smallest mean number of sample points for each cluster of k-means: with fewer points clusters become empty.
POINTS_PER_WORD = 8


class Vocabulary(NamedTuple):
    """The words of a bag of features.

    words: (L, d) float64, the words, in the space of the point descriptors.
    """

    words: FloatArray
    gap: float

    def weights(self, features: FloatArray, width: float) -> FloatArray:
        """The soft assignment of point descriptors to the words.

        features: (n, d) float64, the point descriptors.
        width: σ, in the unit of the point descriptors.
        Returns (n, L) float64: proportional to exp(−‖p − w‖² / 2σ²) for point descriptor p and word w; each
            row sums to 1.
        """
        squared = cdist(features, self.words, "sqeuclidean")  # (n, L)
        # Subtracting the smallest distance keeps the sum from underflowing to zero far from all words.
        nearness = np.exp(-(squared - squared.min(axis=1, keepdims=True)) / (2 * width**2))
        belongs: FloatArray = nearness / nearness.sum(axis=1, keepdims=True)
        return belongs


def clustered(sample: FloatArray, n_words: int) -> Vocabulary:
    """The vocabulary of a sample of point descriptors, by k-means from a fixed start.

    sample: (s, d) float64, point descriptors.
    """
    most = len(sample) // POINTS_PER_WORD
    if not 2 <= n_words <= most:
        raise OptionError(f"n_values must be between 2 and {most} for a bag of words, got {n_words}")
    start = np.random.default_rng(0).choice(len(sample), n_words, replace=False)
    words, _ = kmeans2(sample, sample[start], iter=50, minit="matrix")
    gaps = cdist(words, words)
    np.fill_diagonal(gaps, np.inf)
    return Vocabulary(words, float(np.median(gaps.min(axis=1))))
