"""Distance matrices: all distances between the shapes of a gallery, however they were computed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from pcretrieve.errors import InputError
from pcretrieve.retrieval import DistanceBlock, Positions, Ranking, nearest_of, position_of
from pcretrieve.values import FloatArray, Neighbors
from pcretrieve.values.base import Value, locked

__all__ = ["DistanceMatrix", "distance_matrix"]


@dataclass(frozen=True, slots=True, eq=False)
class DistanceMatrix(Value):
    """All distances between the shapes of a gallery: a `Ranking`.

    Attributes
    ----------
    ids : tuple of str, length N
        Identifiers of the shapes, distinct.
    values : (N, N) float64
        Row i has the distances from shape i as a query to all shapes. Not negative, may be infinite; need not
        be symmetric, nor zero on the diagonal.
    labels : tuple of (str or None), length N
        Class of each shape; None if unknown.
    """

    ids: tuple[str, ...]
    values: FloatArray
    labels: tuple[str | None, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "ids", tuple(self.ids))
        n = len(self.ids)
        if len(set(self.ids)) != n:
            twice = next(one for number, one in enumerate(self.ids) if one in self.ids[:number])
            raise InputError(f"ids of a distance matrix must be distinct, {twice!r} comes twice")
        values = locked("a distance matrix", self.values, (n, n), finite=False)
        if (negative := int((values < 0).sum())) > 0:
            raise InputError(
                f"distances must be 0 or more, got {negative} that are negative; turn similarities into "
                "distances first"
            )
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "labels", tuple(self.labels) or (None,) * n)
        if len(self.labels) != n:
            raise InputError(f"labels must be as many as ids ({n}), got {len(self.labels)}")

    def __len__(self) -> int:
        return len(self.ids)

    def select(self, ids: Sequence[str]) -> DistanceMatrix:
        """The distances between some of the shapes; ValueError if there is no shape of such an id."""
        chosen = [self.ids.index(shape_id) for shape_id in ids]
        labels = tuple(self.labels[row] for row in chosen)
        return DistanceMatrix(tuple(ids), self.values[np.ix_(chosen, chosen)], labels)

    def blocks(self, queries: Positions | None = None) -> Iterator[DistanceBlock]:
        """Distances from shapes of the gallery to all of the gallery.

        Parameters
        ----------
        queries : (Q,) intp, optional
            Positions in `ids`. By default all.

        Yields
        ------
        DistanceBlock
            All queries, in one block.
        """
        rows = np.arange(len(self)) if queries is None else queries
        yield DistanceBlock(rows, self.values[rows])

    def nearest(self, shape_id: str, k: int = 10) -> Neighbors:
        """The shapes nearest to a shape of the gallery, itself included.

        Parameters
        ----------
        shape_id : str
            One of `ids`.
        k : int, default 10
            Number of shapes, at least 1; all if there are fewer.

        Returns
        -------
        Neighbors
            Nearest first, equally near shapes in alphabetical order.
        """
        return nearest_of(self.ids, self.values[position_of(self.ids, shape_id)], k)


def distance_matrix(ranking: Ranking, labels: tuple[str | None, ...] = ()) -> DistanceMatrix:
    """Compute all distances of a gallery."""
    values = np.empty((len(ranking.ids), len(ranking.ids)))
    for block in ranking.blocks():
        values[block.queries] = block.distances
    return DistanceMatrix(tuple(ranking.ids), values, labels)
