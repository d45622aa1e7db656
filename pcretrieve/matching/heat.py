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

from typing import NamedTuple

import numpy as np
from scipy.spatial.distance import cdist

from pcretrieve.descriptors.hks_bow import heat_features
from pcretrieve.spectral import unit_eigenpairs
from pcretrieve.values import FloatArray, Shape

__all__ = ["HeatSet", "heat_distance", "heat_set"]

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
