"""Modified Hausdorff distance of the heat kernel signatures of two surfaces.

Each surface is a weighted set of points in the space of heat kernel signatures. The directed distance is the
mean over one set of the distance to the nearest point of the other; the distance is the larger of the two
directed distances [1]_. No vector of a single shape has such distances: which point is the nearest depends on
both shapes.

References
----------
.. [1] M. Dubuisson and A. Jain, "A modified Hausdorff distance for object matching", ICPR 1994.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.spatial.distance import cdist, cityblock

from pcretrieve.descriptors.bags import POINTS_PER_WORD, Vocabulary, clustered, heat_features
from pcretrieve.errors import InputError
from pcretrieve.spectral import unit_eigenpairs
from pcretrieve.values import FloatArray, Shape

# Number of eigenpairs in the heat kernel: 60 modes, as `hks_bow` has by default.
N_PAIRS = 61

# Number of points by which a surface is represented. See docs/decisions.md, N_SAMPLES.
N_SAMPLES = 300


class HeatSet(NamedTuple):
    """Heat kernel signatures that represent those of all vertices of a surface.

    features: (s, 6) float64, the signatures, as in `heat_features`; dimensionless.
    weights: (s,) float64, the share of the area of the surface that each of them represents; the sum is 1.
    """

    features: FloatArray
    weights: FloatArray


def heat_set(shape: Shape) -> HeatSet:
    """The heat kernel signatures of the first surface of a shape."""
    pairs = unit_eigenpairs(shape.mesh, N_PAIRS)
    features = heat_features(pairs)  # (n, 6)
    areas = np.asarray(pairs.mass.sum(axis=0)).ravel()  # (n,)
    nearest = np.zeros(len(features), dtype=np.intp)  # (n,): the nearest sample so far
    gaps = np.linalg.norm(features - areas @ features / areas.sum(), axis=1)  # (n,)
    samples: list[int] = []
    while len(samples) < min(N_SAMPLES, len(features)):
        farthest = int(gaps.argmax())
        apart = np.linalg.norm(features - features[farthest], axis=1)
        closer = apart < gaps if samples else np.ones(len(features), dtype=bool)
        nearest[closer], gaps[closer] = len(samples), apart[closer]
        samples.append(farthest)
    weights = np.bincount(nearest, weights=areas, minlength=len(samples)) / areas.sum()
    return HeatSet(features[samples], weights)


def heat_distance(query: HeatSet, other: HeatSet) -> float:
    """The modified Hausdorff distance of two sets of heat kernel signatures."""
    apart = cdist(query.features, other.features)  # (s, t)
    return float(max(query.weights @ apart.min(axis=1), other.weights @ apart.min(axis=0)))


# Number of eigenpairs in the heat kernel: 60 modes, as `hks_bow` has by default.


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

    The open settings, and deviations from the article: 48 words, which are
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
