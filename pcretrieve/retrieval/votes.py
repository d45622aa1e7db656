"""The class that the neighbours of a query vote for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pcretrieve.values import FloatArray


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
