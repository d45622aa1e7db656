"""What the neighbours of a query say: the class that they vote for, and how certain their ranks are.

The error bar of a query is carried into the ranks of its results by random draws (Monte Carlo).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pcretrieve.retrieval.index import SignatureIndex
from pcretrieve.values import FloatArray, Signature

# Number of draws of the query, and their seed.
N_DRAWS = 200
SEED = 0

# Quantiles of the ranks between which a rank lies in nine draws of ten.
QUANTILES = (0.05, 0.95)


@dataclass(frozen=True, slots=True)
class Vote:
    """The class with the largest share of the weight of all voters, and its lead over the next class."""

    label: str
    share: float
    margin: float
    n_voters: int


def class_vote(labels: Sequence[str | None], weights: FloatArray) -> Vote | None:
    """The class that the neighbours of a query vote for, with weights (k,) such as their scores."""
    total: dict[str, float] = {}
    for label, weight in zip(labels, weights.tolist(), strict=True):
        if label is not None:
            total[label] = total.get(label, 0.0) + weight
    everything = sum(total.values())
    if not everything:
        return None
    ranked = sorted(total.items(), key=lambda item: (-item[1], item[0]))
    next_best = ranked[1][1] if len(ranked) > 1 else 0.0
    n_voters = sum(label is not None for label in labels)
    label, best = ranked[0]
    return Vote(label, best / everything, (best - next_best) / everything, n_voters)


def rank_ranges(
    index: SignatureIndex, query: str | Signature, deviation: FloatArray, ids: Sequence[str]
) -> NDArray[np.intp]:
    """The ranks of the results of a query whose coordinates are normally distributed round the measured ones.

    deviation: (L,) float64, of each coordinate before whitening, such as `Signature.deviation`.
    Returns (m, 2) intp: the lowest and the highest rank of each shape among `ids` in nine of ten draws.
    """
    point = index.point_of(query)
    drawn = deviation * np.random.default_rng(SEED).normal(size=(N_DRAWS, len(deviation)))
    # The whitening is affine: a difference is mapped by its matrix alone.
    moved = point + drawn @ index.whitening.matrix.T
    order = np.argsort(index.between(ids, moved), axis=1, kind="stable")
    ranks = np.argsort(order, axis=1) + 1  # (N_DRAWS, m)
    low = np.quantile(ranks, QUANTILES[0], axis=0, method="lower")
    high = np.quantile(ranks, QUANTILES[1], axis=0, method="higher")
    return np.stack([low, high], axis=1).astype(np.intp)


def swapping_ranks(ranges: NDArray[np.intp]) -> list[tuple[int, int]]:
    """First and last of each run of ranks, from 1, that could swap, by the ranges (k, 2) of the results."""
    runs: list[tuple[int, int]] = []
    for rank in range(1, len(ranges)):
        if ranges[:rank, 1].max() >= ranges[rank:, 0].min():  # one before could come behind one after
            if runs and runs[-1][1] == rank:
                runs[-1] = runs[-1][0], rank + 1
            else:
                runs.append((rank, rank + 1))
    return runs
