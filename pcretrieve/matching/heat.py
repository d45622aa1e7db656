"""Heat kernel signatures of two surfaces, compared as sets of points or by the words of a gallery.

By the modified Hausdorff distance [1]_, each surface is a weighted set of points in the space of heat kernel
signatures. The directed distance is the mean over one set of the distance to the nearest point of the other;
the distance is the larger of the two directed distances. No vector of a single shape has such distances:
which point is the nearest depends on both shapes.

References
----------
.. [1] M. Dubuisson and A. Jain, "A modified Hausdorff distance for object matching", ICPR 1994.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.spatial.distance import cdist

from pcretrieve.descriptors.bags import POINTS_PER_WORD, Vocabulary, clustered, heat_features
from pcretrieve.errors import InputError
from pcretrieve.spectral import unit_eigenpairs
from pcretrieve.values import FloatArray, Shape

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
            features[rng.choice(len(shares), min(number, len(shares)), replace=False, p=shares)]
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
    return np.asarray(points.shares @ vocabulary.weights(points.features, 2 * vocabulary.gap))
