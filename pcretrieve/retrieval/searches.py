"""Searches of Euclidean nearest neighbours by other packages: a ball tree [1]_, the flat scan of faiss [2]_.

They find candidates only, which are then sorted by their exact distances, so that answers do not depend on
the search.

References
----------
.. [1] Omohundro, "Five balltree construction algorithms", International Computer Science Institute 1989.
.. [2] Douze et al., "The Faiss library", 2024.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import OptionError
from pcretrieve.retrieval.distances import DISTANCES
from pcretrieve.retrieval.faiss import FlatScan
from pcretrieve.retrieval.scikit_learn import BallTreeSearch
from pcretrieve.values import FloatArray

__all__ = ["SEARCHES", "EuclideanSearch", "check_searchable"]


class EuclideanSearch(Protocol):
    """A search of the Euclidean nearest neighbours among points (N, L)."""

    def nearest(self, point: FloatArray, k: int) -> tuple[NDArray[np.intp], float]:
        """Near points, and how far all others are at least.

        point: (1, L) float64, the query.
        Returns rows : (k,) intp: the points that are found.
        """
        ...

    def within(self, point: FloatArray, radius: float) -> NDArray[np.intp]:
        """Points near a query, all within a radius among them.

        point: (1, L) float64, the query.
        Returns (n,) intp: the points.
        """
        ...


# Values of the option `nearest` beside "auto" and "scan", the search by the lower bounds of this package.
SEARCHES: dict[str, Callable[[FloatArray], EuclideanSearch]] = {"tree": BallTreeSearch, "faiss": FlatScan}


def check_searchable(nearest: str, distance: str) -> None:
    """Check that a search finds the neighbours by a distance."""
    if nearest in SEARCHES and DISTANCES[distance].at_least != "log":
        able = " or ".join(name for name, each in DISTANCES.own.items() if each.at_least == "log")
        raise OptionError(
            f"distance must be {able} for nearest = {nearest!r}, which searches by Euclidean distances, got "
            f"{distance!r}; use nearest = 'scan'"
        )
