"""The covariance of what shapes differ by that are among each other's nearest."""

from __future__ import annotations

from typing import Literal

import numpy as np

from pcretrieve.errors import OptionError
from pcretrieve.options import Shrinkage
from pcretrieve.retrieval.covariances import shrunk
from pcretrieve.retrieval.pairs import neighbour_pairs
from pcretrieve.retrieval.regularisation import DEFAULT_SHRINKAGE, CovarianceFit, inverse_square_root
from pcretrieve.values import FloatArray

__all__ = ["LEAST_SHAPES", "neighbour_covariance"]

# Shrinkage of the covariance of neighbours towards the covariance of changes of resolution, where that is
# known, and the remaining shrinkage towards the identity. See docs/decisions.md, PRIOR_SHARE.
PRIOR_SHARE = 0.3
SHRINKAGE_WITH_PRIOR = 0.03

# Least numbers of shapes and of pairs for a whitening by neighbours. See docs/decisions.md, LEAST_SHAPES.
LEAST_SHAPES = 24
LEAST_PAIRS = 10


def neighbour_covariance(
    logs: FloatArray,
    shrinkage: Shrinkage,
    n_neighbors: int | Literal["auto"],
    rounds: int,
    prior: FloatArray | None,
) -> CovarianceFit | str:
    """The covariance of the differences of neighbours.

    logs: (N, L) float64, log-signatures.
    prior: (L, L) float64 or None, as in `fit_whitening`.
    """
    if rounds < 1:
        raise OptionError(f"rounds must be at least 1, got {rounds}")
    if len(logs) < LEAST_SHAPES:
        return f"none, because {len(logs)} shapes are too few to learn from neighbours ({LEAST_SHAPES})"
    if shrinkage == "auto":
        used = DEFAULT_SHRINKAGE["neighbours"] if prior is None else SHRINKAGE_WITH_PRIOR
    else:
        used = float(shrinkage)
    whitened = logs
    for _ in range(rounds):
        pairs = neighbour_pairs(whitened, n_neighbors)
        if len(pairs.weights) < LEAST_PAIRS:
            return (
                f"none, because only {len(pairs.weights)} pairs of shapes are mutual neighbours "
                f"({LEAST_PAIRS})"
            )
        differences = logs[pairs.first] - logs[pairs.second]  # (P, L)
        covariance = (differences * pairs.weights[:, np.newaxis]).T @ differences
        covariance /= np.trace(covariance)
        if prior is not None:
            covariance = (1 - PRIOR_SHARE) * covariance + PRIOR_SHARE * prior
        covariance = shrunk(covariance, used)
        whitened = logs @ inverse_square_root(covariance) if rounds > 1 else logs
    reason = f"neighbours: {len(pairs.weights)} pairs, each among the other's {pairs.n_neighbors} nearest"
    return CovarianceFit(logs, covariance, used, reason)
