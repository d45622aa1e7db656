"""ShapeGoogle as published: bags of features with a vocabulary that is learned from the gallery.

The frequencies of words are compared by the sum of their absolute differences. They are those of no shape
alone: another gallery has other words. `pcretrieve.descriptors.hks_bow` has the same words for all galleries.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.spatial.distance import cityblock

from pcretrieve.descriptors.hks_bow import heat_features
from pcretrieve.descriptors.vocabulary import POINTS_PER_WORD, Vocabulary, clustered
from pcretrieve.errors import InputError
from pcretrieve.spectral import unit_eigenpairs
from pcretrieve.values import FloatArray, Shape

__all__ = ["HeatPoints", "heat_points", "word_distance", "word_frequencies"]

# Number of eigenpairs in the heat kernel: 60 modes, as `hks_bow` has by default.
N_PAIRS = 61

# Words of the vocabulary, as published, and the points of each shape that they are the centres of.
N_WORDS = 48
N_POINTS = 100


class HeatPoints(NamedTuple):
    """Heat kernel signatures of all vertices of a surface.

    features: (n, 6) float64, the signatures, as in `heat_features`; dimensionless.
    shares: (n,) float64, the share of the area of the surface that each vertex represents; the sum is 1.
    """

    features: FloatArray
    shares: FloatArray


def heat_points(shape: Shape) -> HeatPoints:
    """The heat kernel signatures of the first surface of a shape."""
    pairs = unit_eigenpairs(shape.mesh, N_PAIRS)
    areas = np.asarray(pairs.mass.sum(axis=0)).ravel()  # (n,)
    return HeatPoints(heat_features(pairs), areas / areas.sum())


def word_frequencies(gallery: Sequence[HeatPoints]) -> Callable[[HeatPoints], FloatArray]:
    """Learn a vocabulary from a gallery [1]_, sections 3 and 4.

    The open settings, and deviations from the article (see docs/decisions.md, N_WORDS): 48 words, which are
    the cluster centres (k-means from a fixed start) of random points of the gallery, drawn in proportion to
    area; soft assignment with σ twice the median gap between neighbouring words.

    Returns function of HeatPoints that returns (48,) float64: the share of the area of a surface that each
        word has. Not negative, of sum 1, dimensionless. The function can be pickled.

    References
    ----------
    .. [1] A. Bronstein, M. Bronstein, L. Guibas and M. Ovsjanikov, "Shape Google: geometric words and
       expressions for invariant shape retrieval", ACM Transactions on Graphics 30 (2011).
    """
    rng = np.random.default_rng(0)
    fewest = N_WORDS * POINTS_PER_WORD
    # Small galleries give more points of each shape.
    number = max(N_POINTS, -(-fewest // len(gallery)))
    drawn = [
        points.features[
            rng.choice(len(points.shares), min(number, len(points.shares)), replace=False, p=points.shares)
        ]
        for points in gallery
    ]
    sample = np.concatenate(drawn)  # (s, 6)
    if len(sample) < fewest:
        raise InputError(
            f"a vocabulary of {N_WORDS} words needs a gallery of at least {fewest} vertices, got "
            f"{len(sample)}: add shapes, or use the descriptor hks-bow"
        )
    return partial(_frequencies, clustered(sample, N_WORDS))


def word_distance(query: FloatArray, other: FloatArray) -> float:
    """The sum of the absolute differences of the frequencies of words.

    query, other: (48,) float64, the frequencies by the same vocabulary.
    """
    return float(cityblock(query, other))


def _frequencies(vocabulary: Vocabulary, points: HeatPoints) -> FloatArray:
    """(48,) shares of the area of a surface that the words have."""
    shares: FloatArray = points.shares @ vocabulary.weights(points.features, 2 * vocabulary.gap)
    return shares
