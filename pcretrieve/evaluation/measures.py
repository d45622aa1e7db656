"""Retrieval measures of the Princeton Shape Benchmark, and mean average precision.

Each labelled shape is a query; all the others are ranked by distance, ties by id. Let C be the size of the
query's class, itself and failed shapes included, so that R = C − 1 shapes are relevant. Per query [1]_:

    NN    1 where the nearest shape is relevant, else 0
    FT    relevant shapes among the R nearest / R                                         first tier
    ST    relevant shapes among the 2R nearest / R                                        second tier
    E     2 / (1/P + 1/R′), precision P and recall R′ of the 32 nearest
    DCG   Σ g(rank of each relevant shape) / Σ g(1 … R), g(1) = 1 and g(i) = 1 / log₂ i
    AP    mean over the R relevant shapes of the precision at the rank of each; 0 for those not ranked

and the mean over the queries (the benchmark's micro-average). Where a list is shorter than 32 or than 2R, it
is taken whole. Conventions that the benchmark leaves open:

- A failed shape counts: as a query it scores 0 on every measure, and for the others of its class it is a
  relevant shape that is never ranked.
- A shape alone in its class is no query, as nothing is relevant to it; it stays in the gallery.
- So does a shape without a label.

References
----------
.. [1] Shilane, Min, Kazhdan and Funkhouser, "The Princeton Shape Benchmark", Shape Modeling International
   2004, section 4.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import OptionError
from pcretrieve.evaluation.rankings import Rankings
from pcretrieve.retrieval import Positions
from pcretrieve.types import FloatArray
from pcretrieve.values import Value

__all__ = [
    "PrecisionRecall",
    "QueryScores",
    "RetrievalMeasures",
    "evaluate_rankings",
    "precision_recall",
    "query_scores",
]

# Shilane et al.: about what a user sees on one screen.
E_CUTOFF = 32


@dataclass(frozen=True, slots=True, eq=False)
class QueryScores(Value):
    """The measures of each query, as (Q,) arrays in [0, 1]; `ids` and `labels` as in `Rankings`."""

    ids: tuple[str | None, ...]
    labels: tuple[str, ...]
    nn: FloatArray
    ft: FloatArray
    st: FloatArray
    e: FloatArray
    dcg: FloatArray
    ap: FloatArray


@dataclass(frozen=True, slots=True)
class RetrievalMeasures:
    """Means over all queries, in [0, 1], larger is better; 1 is perfect for all but E.

    Attributes
    ----------
    nn, ft, st, e, dcg, map : float
    n_queries : int
        Shapes averaged over, failed ones included.
    n_failed : int
        Those of them that failed.
    n_single : int
        Shapes left out because they are alone in their class.
    """

    nn: float
    ft: float
    st: float
    e: float
    dcg: float
    map: float
    n_queries: int
    n_failed: int
    n_single: int


class PrecisionRecall(NamedTuple):
    """A mean precision–recall curve: (n,) recall, ascending from 0 to 1, and (n,) precision."""

    recall: FloatArray
    precision: FloatArray


def query_scores(ranked: Rankings) -> QueryScores:
    """The measures of each query, by the definitions at the top of this file."""
    query, rank, n_relevant = ranked.hit_query, ranked.hit_rank, ranked.n_relevant
    n_shown = min(E_CUTOFF, ranked.n_ranked)
    ideal = np.cumsum(_gain(np.arange(1, n_relevant.max(initial=1) + 1)))

    def per_query(value: NDArray[np.generic]) -> FloatArray:
        """(Q,) sums over the hits of each query."""
        return np.asarray(np.bincount(query, weights=value, minlength=len(n_relevant)), dtype=np.float64)

    return QueryScores(
        ids=ranked.ids,
        labels=ranked.labels,
        nn=per_query(rank == 1),
        ft=per_query(rank <= n_relevant[query]) / n_relevant,
        st=per_query(rank <= 2 * n_relevant[query]) / n_relevant,
        # With h hits P = h / n_shown and R′ = h / R, and the harmonic mean simplifies.
        e=2 * per_query(rank <= n_shown) / (n_shown + n_relevant),
        dcg=per_query(_gain(rank)) / ideal[n_relevant - 1],
        ap=per_query(_precision_at_hits(ranked)) / n_relevant,
    )


def evaluate_rankings(ranked: Rankings) -> RetrievalMeasures:
    """The mean of each measure over all queries."""
    scores = query_scores(ranked)
    return RetrievalMeasures(
        nn=float(scores.nn.mean()),
        ft=float(scores.ft.mean()),
        st=float(scores.st.mean()),
        e=float(scores.e.mean()),
        dcg=float(scores.dcg.mean()),
        map=float(scores.ap.mean()),
        n_queries=len(ranked.labels),
        n_failed=ranked.n_failed,
        n_single=ranked.n_single,
    )


def precision_recall(ranked: Rankings, *, n_points: int = 11) -> PrecisionRecall:
    """Mean interpolated precision at equidistant levels of recall.

    A query's precision at recall r is the largest that it has at any recall of r or more, and 0 where it
    never gets that far.

    Parameters
    ----------
    ranked : Rankings
    n_points : int
        Levels from 0 to 1; 11 by custom.
    """
    if n_points < 2:
        raise OptionError(f"n_points must be at least 2, got {n_points}")
    levels = np.arange(n_points)
    precision = _precision_at_hits(ranked)
    first = np.searchsorted(ranked.hit_query, np.arange(len(ranked.n_relevant) + 1))
    total = np.zeros(n_points)
    for query, n_relevant in enumerate(ranked.n_relevant):
        own = precision[first[query] : first[query + 1]]
        best_from = np.append(np.maximum.accumulate(own[::-1])[::-1], np.zeros(n_relevant - len(own)))
        # Hits that reach recall i / (n_points − 1), at least one: the ceiling in whole numbers.
        needed = np.maximum(1, -(-levels * n_relevant // (n_points - 1)))
        total += best_from[needed - 1]
    return PrecisionRecall(levels / (n_points - 1), total / len(ranked.n_relevant))


def _gain(rank: Positions) -> FloatArray:
    """Discounted gain: 1 at ranks 1 and 2, and 1 / log₂ rank from there."""
    gain: FloatArray = 1 / np.log2(np.maximum(rank, 2))
    return gain


def _precision_at_hits(ranked: Rankings) -> FloatArray:
    """(H,) of the list down to each hit: its number among the hits of its query over its rank."""
    first = np.searchsorted(ranked.hit_query, ranked.hit_query)
    precision: FloatArray = (np.arange(len(first)) - first + 1) / ranked.hit_rank
    return precision
