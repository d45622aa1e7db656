"""Distances between signatures, as functions of the difference of their coordinates.

The coordinates of a signature are the logarithms of its values, if that is its metric. Let a and b be two
signatures and x = log a − log b, element by element. Then

    d1    Σ |a − b| / (a + b)      = Σ tanh(|x| / 2)         a metric, at most L
    d2    √ Σ (a − b)² / (a b)     = √ Σ 4 sinh²(x / 2)      not a metric
    log   √ Σ x²                                             a metric, and log ≤ d2, since |sinh u| ≥ |u|

`d1` and `d2` are the dissimilarities D₁ and D₂ of Ye and Yu [1]_ (D₂ is equation (11)). If a whitening maps
log-signatures to y, the distances are those of the positive vectors exp(y).

Signatures that are compared as they are have their values as coordinates, and histograms the square roots of
their bins. Of the distances above, only `log` is meaningful for them, which is then the Euclidean distance of
the values, and √2 times the Hellinger distance of histograms with the sum 1.

References
----------
.. [1] Ye and Yu, "A fast modal space transform for robust nonrigid shape retrieval", The Visual Computer
   2016, section 2.4.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcretrieve.errors import InputError, OptionError
from pcretrieve.values import FloatArray, Metric, SignatureTable

# Number of differences in memory at once: 1 MiB, which fits the processor's second-level cache.
CHUNK_VALUES = 2**17


def _d1(x: FloatArray) -> FloatArray:
    total: FloatArray = np.tanh(np.abs(x) / 2).sum(axis=-1)
    return total


def _d2(x: FloatArray) -> FloatArray:
    # sinh²(x / 2) overflows float64 if |x| > 710: an infinite distance is then the intended result.
    with np.errstate(over="ignore"):
        root: FloatArray = np.sqrt((4 * np.sinh(x / 2) ** 2).sum(axis=-1))
    return root


def _log(x: FloatArray) -> FloatArray:
    root: FloatArray = np.sqrt((x**2).sum(axis=-1))
    return root


@dataclass(frozen=True, slots=True)
class Distance:
    """A distance of signatures, of pcretrieve or of one's own.

    between: function of (…, L) float64 that returns (…) float64, distances from the differences of
        coordinates, the last axis of which is summed over.
    metrics: the metrics of the signatures that the distance is meaningful for.
    exceeds_log: whether it is never smaller than `log`, whose lower bounds the index then uses; otherwise
        each query is compared with all shapes.
    """

    name: str
    between: Callable[[FloatArray], FloatArray]
    metrics: tuple[Metric, ...] = ("logarithms",)
    exceeds_log: bool = False

    def __post_init__(self) -> None:
        if wrong := sorted(set(self.metrics).difference(get_args(Metric))):
            known = ", ".join(get_args(Metric))
            raise OptionError(f"metrics of a distance must be of {known}, got {wrong[0]!r}")


DISTANCES = {
    distance.name: distance
    for distance in (
        Distance("log", _log, metrics=("logarithms", "values", "histograms"), exceeds_log=True),
        Distance("d1", _d1),
        Distance("d2", _d2, exceeds_log=True),
    )
}


def known_distance(distance: str | Distance) -> Distance:
    """The distance of a name, or the one that is given."""
    if isinstance(distance, Distance):
        return distance
    if distance not in DISTANCES:
        raise OptionError(f"there is no distance {distance!r}; there are {', '.join(DISTANCES)}")
    return DISTANCES[distance]


def coordinates(values: ArrayLike, metric: Metric = "logarithms") -> FloatArray:
    """The coordinates of signatures, of whose differences the distances are functions.

    values: (…, L) array_like, signature values.
    Returns (…, L) float64: the logarithms, the values themselves, or the square roots.
    """
    if metric == "logarithms":
        logs: FloatArray = np.log(_checked(values, "positive and finite", lambda x: np.isfinite(x) & (x > 0)))
        return logs
    array = _checked(values, "finite", np.isfinite)
    if metric == "values":
        return array
    roots: FloatArray = np.sqrt(_checked(array, "bins of a histogram, not negative", lambda x: x >= 0))
    return roots


def log_signatures(values: ArrayLike) -> FloatArray:
    """Natural logarithms (…, L) of signature values, which are positive and finite; dimensionless."""
    return coordinates(values, "logarithms")


def table_coordinates(table: SignatureTable, distance: str | Distance) -> FloatArray:
    """The coordinates (N, L) of the signatures in a table, for a distance."""
    check_comparable(table.kind, table.metric, distance)
    return coordinates(table.values, table.metric)


def check_comparable(kind: str, metric: Metric, distance: str | Distance) -> None:
    """Check that a distance is meaningful for signatures."""
    asked = known_distance(distance)
    if metric not in asked.metrics:
        meaningful = ", ".join(name for name, each in DISTANCES.items() if metric in each.metrics)
        raise OptionError(
            f"distance must be {meaningful} for {kind}, which is compared as {metric}, got {asked.name!r}"
        )


def pairwise(distance: str | Distance, queries: FloatArray, gallery: FloatArray) -> FloatArray:
    """Distances of all queries to all shapes of the gallery.

    The floating-point result for a pair depends on this pair alone: equal signatures have exactly equal
    distances, and d(a, b) = d(b, a) exactly.

    queries: (Q, L) float64, coordinates, with or without whitening.
    gallery: (N, L) float64, coordinates with the same whitening.
    Returns (Q, N) float64: dimensionless.
    """
    between = known_distance(distance).between
    if queries.ndim != 2 or gallery.ndim != 2 or queries.shape[1] != gallery.shape[1]:
        raise InputError(
            f"queries and gallery must have shapes (Q, L) and (N, L), got {queries.shape} and {gallery.shape}"
        )
    n_values = max(1, gallery.shape[1])
    columns = max(1, min(len(gallery), CHUNK_VALUES // n_values))
    rows = max(1, CHUNK_VALUES // (n_values * columns))
    distances = np.empty((len(queries), len(gallery)))
    for i in range(0, len(queries), rows):
        for j in range(0, len(gallery), columns):
            x = queries[i : i + rows, np.newaxis] - gallery[np.newaxis, j : j + columns]  # (rows, columns, L)
            distances[i : i + rows, j : j + columns] = between(x).reshape(x.shape[:2])
    return distances


def _checked(values: ArrayLike, kind: str, holds: Callable[[FloatArray], NDArray[np.bool_]]) -> FloatArray:
    """The values as an array, all of which are of a kind."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"signature values must be an array of numbers, got {values!r}") from error
    bad = array[~holds(array)]
    if bad.size:
        raise InputError(
            f"signature values must be {kind}, got {bad[0]} ({bad.size} such values of "
            f"{array.size}); compute the signature again"
        )
    return array
