"""Retrieval measures of the Princeton Shape Benchmark, and mean average precision.

Each labelled shape is a query, for which all other shapes are ranked by distance, equal distances by
identifier. Let C be the size of its class, including the query and shapes that failed: R = C − 1 shapes are
relevant. For each query [1]_:

    NN    1 where the nearest shape is relevant, else 0
    FT    relevant shapes among the R nearest / R                                         first tier
    ST    relevant shapes among the 2R nearest / R                                        second tier
    E     2 / (1/P + 1/R′), precision P and recall R′ of the 32 nearest
    DCG   Σ g(rank of each relevant shape) / Σ g(1 … R), g(1) = 1 and g(i) = 1 / log₂ i
    AP    mean over the R relevant shapes of the precision at the rank of each; 0 for shapes not ranked

The micro-average is the mean over the queries, and the macro-average the mean over the classes of the means
of their queries, in which small classes count as much as large ones. A list that is shorter than 32, or than
2R, is used as a whole. Conventions that the benchmark does not define:

- A shape that failed is a miss: as a query its measures are 0, and for the other shapes of its class it is a
  relevant shape that is not ranked.
- A shape that is alone in its class is not a query, since no shape is relevant to it. It is in the gallery.
- A shape without a label is not a query. It is in the gallery.

References
----------
.. [1] Shilane, Min, Kazhdan and Funkhouser, "The Princeton Shape Benchmark", Shape Modeling International
   2004, section 4.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from html import escape
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcretrieve.evaluation.rankings import Rankings
from pcretrieve.retrieval import Positions
from pcretrieve.values import FloatArray
from pcretrieve.values.base import Value

#: The measures, in the order of the columns of `QueryScores.columns`.
MEASURES = ("nn", "ft", "st", "e", "dcg", "map")

# Length of the list of which E is computed, as in the benchmark: about the results that fit on a screen.
E_CUTOFF = 32


@dataclass(frozen=True, slots=True, eq=False)
class QueryScores(Value):
    """The measures of each query.

    nn, ft, st, e, dcg, ap: (Q,) float64, the measures, between 0 and 1.
    """

    ids: tuple[str, ...]
    labels: tuple[str, ...]
    nn: FloatArray
    ft: FloatArray
    st: FloatArray
    e: FloatArray
    dcg: FloatArray
    ap: FloatArray

    @property
    def columns(self) -> FloatArray:
        """(Q, 6) float64, the measures of each query in the order of `MEASURES`."""
        return np.column_stack([self.nn, self.ft, self.st, self.e, self.dcg, self.ap])


@dataclass(frozen=True, slots=True)
class RetrievalMeasures:
    """Averages of the measures over all queries, or over all classes.

    Attributes
    ----------
    nn, ft, st, e, dcg, map : float
        Between 0 and 1, larger is better. The largest possible value is 1, except for E.
    n_queries : int
        Number of queries, including shapes that failed.
    n_failed : int
        Number of queries that failed.
    n_single : int
        Number of shapes that are alone in their class and therefore no queries.
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

    def _repr_html_(self) -> str:
        return table_html({"": self})


def table_html(rows: Mapping[str, RetrievalMeasures]) -> str:
    """A table for notebooks, with a row of measures for each name."""
    names = [part.name for part in fields(RetrievalMeasures)]
    lines = ["<th>" + "<th>".join(["", *names])]
    for row, measured in rows.items():
        cells = "".join(f"<td>{getattr(measured, name):.4g}" for name in names)
        lines.append(f"<th>{escape(row)}{cells}")
    return f"<table><tr>{'<tr>'.join(lines)}</table>"


class PrecisionRecall(NamedTuple):
    """A mean precision–recall curve.

    recall: (n,) float64, equidistant levels from 0 to 1.
    precision: (n,) float64, mean interpolated precision at each level.
    """

    recall: FloatArray
    precision: FloatArray


def query_scores(ranked: Rankings) -> QueryScores:
    """The measures of each query, as defined at the top of this module."""
    query, rank, n_relevant = ranked.hit_query, ranked.hit_rank, ranked.n_relevant
    n_shown = min(E_CUTOFF, ranked.n_ranked)
    ideal = np.cumsum(_gain(np.arange(1, n_relevant.max(initial=1) + 1)))

    def per_query(value: NDArray[np.generic]) -> FloatArray:
        """(Q,) sums over the relevant shapes in the ranked list of each query."""
        return np.asarray(
            np.bincount(query, weights=value, minlength=len(n_relevant)), dtype=np.float64
        )

    return QueryScores(
        ids=ranked.ids,
        labels=ranked.labels,
        nn=per_query(rank == 1),
        ft=per_query(rank <= n_relevant[query]) / n_relevant,
        st=per_query(rank <= 2 * n_relevant[query]) / n_relevant,
        # With h relevant shapes shown, P = h / n_shown and R′ = h / R; their harmonic mean simplifies.
        e=2 * per_query(rank <= n_shown) / (n_shown + n_relevant),
        dcg=per_query(_gain(rank)) / ideal[n_relevant - 1],
        ap=per_query(_precision_at_hits(ranked)) / n_relevant,
    )


def evaluate_rankings(
    ranked: Rankings, *, average: Literal["micro", "macro"] = "micro"
) -> RetrievalMeasures:
    """The average of each measure."""
    columns = query_scores(ranked).columns
    if average == "macro":
        _, number = np.unique(np.array(ranked.labels), return_inverse=True)
        sizes = np.bincount(number)
        columns = columns * (len(number) / (len(sizes) * sizes[number]))[:, np.newaxis]
    means = columns.mean(axis=0)
    return RetrievalMeasures(
        **dict(zip(MEASURES, means.tolist(), strict=True)),
        n_queries=len(ranked.labels),
        n_failed=ranked.n_failed,
        n_single=ranked.n_single,
    )


def precision_recall(ranked: Rankings, *, n_points: int = 11) -> PrecisionRecall:
    """Mean interpolated precision at equidistant levels of recall.

    The interpolated precision of a query at recall r is its largest precision at any recall of at least r; 0
    if it does not reach r.
    """
    levels = np.arange(n_points)
    precision = _precision_at_hits(ranked)
    first = np.searchsorted(ranked.hit_query, np.arange(len(ranked.n_relevant) + 1))
    total = np.zeros(n_points)
    for query, n_relevant in enumerate(ranked.n_relevant):
        own = precision[first[query] : first[query + 1]]
        best_from = np.append(
            np.maximum.accumulate(own[::-1])[::-1], np.zeros(n_relevant - len(own))
        )
        # Number of relevant shapes, at least 1, at recall i / (n_points − 1): the ceiling, in integers.
        needed = np.maximum(1, -(-levels * n_relevant // (n_points - 1)))
        total += best_from[needed - 1]
    return PrecisionRecall(levels / (n_points - 1), total / len(ranked.n_relevant))


class Verification(NamedTuple):
    """How well a limit of the distance tells pairs of one class from pairs of two: ROC and DET curves [1]_.

    false_match, false_non_match: (n,) float64, for each limit, ascending, the share of pairs of two classes
        within it, and the share of pairs of one class beyond it.

    References
    ----------
    .. [1] ISO/IEC 19795-1, "Biometric performance testing and reporting".
    """

    false_match: FloatArray
    false_non_match: FloatArray

    @property
    def equal_error(self) -> float:
        """Where both shares are the same."""
        at = np.abs(self.false_match - self.false_non_match).argmin()
        return float(self.false_match[at] + self.false_non_match[at]) / 2

    def missed(self, rate: float) -> float:
        """The share of pairs of one class that is refused at a false-match rate."""
        return float(
            self.false_non_match[
                np.searchsorted(self.false_match, rate, side="right") - 1
            ]
        )


def verification(genuine: FloatArray, impostor: FloatArray) -> Verification | None:
    """The error rates of all limits, from ascending distances; None if there are none of one kind."""
    if not len(genuine) or not len(impostor):
        return None
    limits = np.append(-np.inf, np.unique(genuine))
    within, beside = (
        np.searchsorted(pairs, limits, side="right") / len(pairs)
        for pairs in (genuine, impostor)
    )
    return Verification(beside, 1 - within)


@dataclass(frozen=True, slots=True)
class CurvePoint:
    """How often the right class is found among so many.

    rank_1, rank_5: shares of queries whose own class is the nearest, or one of the five nearest classes;
        rank_5 is nan where it is fitted.
    low, high: the confidence interval (`LEVEL`) of rank_1, by drawing classes again; nan where it is fitted.
    """

    n_classes: int
    rank_1: float
    rank_5: float
    low: float
    high: float
    is_fitted: bool = False


# Numbers of classes of a curve. It is fitted to those from a tenth of the largest collection, and continued
# to ten times this.
SIZES = (2, 3, 5, 10, 30, 100, 300, 1000, 3000, 10_000, 30_000, 100_000)
FITTED = 10


def recognition_curve(
    n_nearer: Positions, labels: ArrayLike, n_classes: int
) -> tuple[CurvePoint, ...]:
    """How often the right class is found, by the number of classes: expected values over random collections.

    In a collection of n of the N classes, a class is found at rank r if fewer than r of the other n − 1 are
    nearer, which has a hypergeometric distribution; nothing is drawn. Each class counts as much as any other.
    Beyond N, 1 − rank-1 is continued as a power of n.

    n_nearer: (Q,) intp, as in `Rankings`. labels: (Q,) the class of each query.
    """
    from scipy.stats import hypergeom

    known = np.array([*(n for n in SIZES if n < n_classes), n_classes])
    of_class = np.unique(np.array(labels), return_inverse=True)[1]
    rates = []
    for r in (1, 5):
        drawn = known[:, np.newaxis] - 1
        # (sizes, Q).
        found = np.asarray(hypergeom.cdf(r - 1, n_classes - 1, n_nearer, drawn))
        sums = [np.bincount(of_class, row) for row in found]
        rates.append(np.transpose(sums) / np.bincount(of_class)[:, np.newaxis])
    first, fifth = (rate.mean(axis=0) for rate in rates)
    columns = np.stack([first, fifth, *bootstrap_interval(rates[0])], axis=1)
    points = zip(known.tolist(), columns.tolist(), strict=True)
    return (*(CurvePoint(n, *row) for n, row in points), *_continued(known, first))


def _continued(known: Positions, rank_1: FloatArray) -> Iterator[CurvePoint]:
    """A curve beyond its largest collection: 1 − rank-1 is continued as a power of the number of classes."""
    used = (known * FITTED >= known[-1]) & (rank_1 < 1)
    if used.sum() > 1:
        power, level = np.polyfit(np.log(known[used]), np.log(1 - rank_1[used]), 1)
        for n in (n for n in SIZES if known[-1] < n <= FITTED * known[-1]):
            rate = max(0.0, 1 - float(np.exp(power * np.log(n) + level)))
            yield CurvePoint(n, rate, np.nan, np.nan, np.nan, is_fitted=True)


def _gain(rank: Positions) -> FloatArray:
    """Discounted gain: 1 at ranks 1 and 2, 1 / log₂ rank at larger ranks."""
    return 1 / np.log2(np.maximum(rank, 2))


def _precision_at_hits(ranked: Rankings) -> FloatArray:
    """(H,) precision of the ranked list down to each relevant shape."""
    first = np.searchsorted(ranked.hit_query, ranked.hit_query)
    return (np.arange(len(first)) - first + 1) / ranked.hit_rank


#: Confidence level of intervals.
LEVEL = 0.95

N_RESAMPLES = 2000

# Number of weights of queries that are in memory at once: 8 MB.
CHUNK = 2**20


def bootstrap_interval(values: FloatArray) -> FloatArray:
    """Confidence intervals of the means of columns, whose rows are drawn again together.

    values: (Q, m) float64, one row for each query, such as `QueryScores.columns`, or differences of such rows
        in a paired comparison.
    Returns (2, m) float64: the lower and the upper ends.
    """
    rng, n = np.random.default_rng(0), len(values)
    rows = max(1, CHUNK // n)
    means = [
        rng.multinomial(n, np.full(n, 1 / n), size=min(rows, N_RESAMPLES - start))
        @ values
        / n
        for start in range(0, N_RESAMPLES, rows)
    ]
    ends: FloatArray = np.quantile(
        np.concatenate(means), [(1 - LEVEL) / 2, (1 + LEVEL) / 2], axis=0
    )
    return ends


# --- classes --------------------------------------------------------------------------------------------


class ClassMeasures(NamedTuple):
    """The queries of one class.

    means: (6,) float64, means of the measures over its queries, in the order of `MEASURES`.
    """

    label: str
    n_queries: int
    means: FloatArray
    confused: tuple[tuple[str | None, int], ...]


class Confusion(NamedTuple):
    """Of which class the nearest shape of each query is.

    counts: (n, m) intp, number of queries of a class whose nearest shape is of another, or the same, class.
        Shapes that failed are not counted.
    """

    labels: tuple[str, ...]
    nearest: tuple[str | None, ...]
    counts: Positions


def class_measures(ranked: Rankings) -> tuple[ClassMeasures, ...]:
    """The measures of each class."""
    columns, labels, table = (
        query_scores(ranked).columns,
        np.array(ranked.labels),
        confusion(ranked),
    )
    found = []
    for label, counts in zip(table.labels, table.counts.tolist(), strict=True):
        near = zip(table.nearest, counts, strict=True)
        confused = sorted(
            ((other, n) for other, n in near if n and other != label),
            key=lambda item: (-item[1], item[0] or ""),
        )
        own = columns[labels == label]
        found.append(ClassMeasures(label, len(own), own.mean(axis=0), tuple(confused)))
    return tuple(found)


def confusion(ranked: Rankings) -> Confusion:
    """The confusion matrix of the nearest neighbour."""
    labels = tuple(sorted(set(ranked.labels)))
    known = sorted(
        {*labels, *(label for label in ranked.nearest_labels if label is not None)}
    )
    nearest = (*known, None)
    counts = np.zeros((len(labels), len(nearest)), dtype=np.intp)
    for label, near, of_class in zip(
        ranked.labels, ranked.nearest, ranked.nearest_labels, strict=True
    ):
        if near is not None:
            counts[labels.index(label), nearest.index(of_class)] += 1
    return Confusion(labels, nearest, counts)
