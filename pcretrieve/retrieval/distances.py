"""Distances between signatures, all of them functions of log-signatures.

Let a and b be two signatures and x = log a − log b, coordinate by coordinate. Then

    d1    Σ |a − b| / (a + b)      = Σ tanh(|x| / 2)         a metric, at most L
    d2    √ Σ (a − b)² / (a b)     = √ Σ 4 sinh²(x / 2)      not a metric
    log   √ Σ x²                                             a metric, and log ≤ d2, since |sinh u| ≥ |u|

`d1` and `d2` are the dissimilarities D₁ and D₂ (equation 11) of Ye and Yu [1]_. All three depend on the
differences of log-signatures alone. Where log-signatures have been whitened to y, they are the distances of
the positive vectors exp(y).

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

# Values held at once while distances are computed: 1 MB, which stays in the processor's cache.
CHUNK_VALUES = 2**17


def _d1(x: FloatArray) -> FloatArray:
    total: FloatArray = np.tanh(np.abs(x) / 2).sum(axis=-1)
    return total


def _d2(x: FloatArray) -> FloatArray:
    # Signatures more than e^700 apart have a D₂ beyond float64: infinite is the right answer there.
    with np.errstate(over="ignore"):
        root: FloatArray = np.sqrt((4 * np.sinh(x / 2) ** 2).sum(axis=-1))
    return root


def _log(x: FloatArray) -> FloatArray:
    root: FloatArray = np.sqrt((x**2).sum(axis=-1))
    return root


#: The distances by name: (…, L) differences of log-signatures to (…) distances.
DISTANCES: Mapping[str, Callable[[FloatArray], FloatArray]] = MappingProxyType(
    {"log": _log, "d1": _d1, "d2": _d2}
)


def log_signatures(values: ArrayLike) -> FloatArray:
    """Natural logarithm of signature values.

    Parameters
    ----------
    values : (…, L) array_like
        Positive and finite; dimensionless.

    Raises
    ------
    InputError
        Where a value is not a positive, finite number.
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
    """Distance of every query to every shape of the gallery.

    A pair's distance depends on that pair alone, to the last bit: equal signatures tie exactly, and
    d(a, b) = d(b, a).

    Parameters
    ----------
    distance : str
        A name in `DISTANCES`.
    queries : (Q, L) float64
        Log-signatures, whitened or not.
    gallery : (N, L) float64
        Log-signatures in the same space.

    Returns
    -------
    (Q, N) float64
        Dimensionless.

    Raises
    ------
    OptionError
        For a distance that does not exist.
    InputError
        Where the two sets do not have the same number of values.
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
