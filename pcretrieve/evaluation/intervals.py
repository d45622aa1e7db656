"""Measures of queries → confidence intervals of their means, by the bootstrap.

The queries are drawn again with replacement, as many as there are, and the interval is that of the
percentiles of the means of these resamples [1]_. It says how far a mean would vary with other queries of the
same kind and the same gallery; queries of one class are treated as independent.

References
----------
.. [1] Efron and Tibshirani, "An introduction to the bootstrap", 1993, chapter 13.
"""

from __future__ import annotations

import numpy as np

from pcretrieve.errors import OptionError
from pcretrieve.values import FloatArray

__all__ = ["LEVEL", "bootstrap_interval"]

#: Confidence level of intervals.
LEVEL = 0.95

N_RESAMPLES = 2000

# Number of weights of queries that are in memory at once: 8 MB.
CHUNK = 2**20


def bootstrap_interval(
    values: FloatArray, *, level: float = LEVEL, rng: np.random.Generator | None = None
) -> FloatArray:
    """Confidence intervals of the means of columns, whose rows are drawn again together.

    values: (Q, m) float64, one row for each query, such as `QueryScores.columns`, or differences of such rows
        in a paired comparison.
    Returns (2, m) float64: the lower and the upper ends.
    """
    if not 0 < level < 1:
        raise OptionError(f"the level of an interval must lie between 0 and 1, got {level}")
    rng = np.random.default_rng(0) if rng is None else rng
    n = len(values)
    rows = max(1, CHUNK // n)
    means = [
        rng.multinomial(n, np.full(n, 1 / n), size=min(rows, N_RESAMPLES - start)) @ values / n
        for start in range(0, N_RESAMPLES, rows)
    ]
    ends: FloatArray = np.quantile(np.concatenate(means), [(1 - level) / 2, (1 + level) / 2], axis=0)
    return ends
