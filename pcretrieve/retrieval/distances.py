"""Distances between signatures, as functions of the difference of their logarithms.

Let a and b be two signatures and x = log a − log b, element by element. Then

    d1    Σ |a − b| / (a + b)      = Σ tanh(|x| / 2)         a metric, at most L
    d2    √ Σ (a − b)² / (a b)     = √ Σ 4 sinh²(x / 2)      not a metric
    log   √ Σ x²                                             a metric, and log ≤ d2, since |sinh u| ≥ |u|

`d1` and `d2` are the dissimilarities D₁ and D₂ of Ye and Yu [1]_ (D₂ is equation (11)). If a whitening maps
log-signatures to y, the distances are those of the positive vectors exp(y).

References
----------
.. [1] Ye and Yu, "A fast modal space transform for robust nonrigid shape retrieval", The Visual Computer
   2016, section 2.4.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from pcretrieve.errors import InputError, OptionError
from pcretrieve.types import FloatArray

__all__ = ["DISTANCES", "log_signatures", "pairwise"]

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


#: The distances by name: functions from (…, L) differences of log-signatures to (…) distances.
DISTANCES: Mapping[str, Callable[[FloatArray], FloatArray]] = MappingProxyType(
    {"log": _log, "d1": _d1, "d2": _d2}
)


def log_signatures(values: ArrayLike) -> FloatArray:
    """Natural logarithms of signature values.

    Parameters
    ----------
    values : (…, L) array_like
        Positive and finite; dimensionless.

    Returns
    -------
    (…, L) float64
        Log-signatures, dimensionless.

    Raises
    ------
    InputError
        If a value is not a positive finite number.
    """
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"signature values must be an array of numbers, got {values!r}") from error
    bad = array[~(np.isfinite(array) & (array > 0))]
    if bad.size:
        raise InputError(
            f"signature values must be positive and finite, got {bad[0]} ({bad.size} such values of "
            f"{array.size}); compute the signature again"
        )
    logs: FloatArray = np.log(array)
    return logs


def pairwise(distance: str, queries: FloatArray, gallery: FloatArray) -> FloatArray:
    """Distances of all queries to all shapes of the gallery.

    The floating-point result for a pair depends on this pair alone: equal signatures have exactly equal
    distances, and d(a, b) = d(b, a) exactly.

    Parameters
    ----------
    distance : str
        A key of `DISTANCES`.
    queries : (Q, L) float64
        Log-signatures, with or without whitening.
    gallery : (N, L) float64
        Log-signatures with the same whitening.

    Returns
    -------
    (Q, N) float64
        Dimensionless.

    Raises
    ------
    OptionError
        If the distance does not exist.
    InputError
        If the two arrays do not have the same number of columns.
    """
    if distance not in DISTANCES:
        raise OptionError(f"distance must be one of {', '.join(DISTANCES)}, got {distance!r}")
    if queries.ndim != 2 or gallery.ndim != 2 or queries.shape[1] != gallery.shape[1]:
        raise InputError(
            f"queries and gallery must have shapes (Q, L) and (N, L), got {queries.shape} and {gallery.shape}"
        )
    between = DISTANCES[distance]
    n_values = max(1, gallery.shape[1])
    columns = max(1, min(len(gallery), CHUNK_VALUES // n_values))
    rows = max(1, CHUNK_VALUES // (n_values * columns))
    distances = np.empty((len(queries), len(gallery)))
    for i in range(0, len(queries), rows):
        for j in range(0, len(gallery), columns):
            x = queries[i : i + rows, np.newaxis] - gallery[np.newaxis, j : j + columns]  # (rows, columns, L)
            distances[i : i + rows, j : j + columns] = between(x)
    return distances
