"""What ranks a gallery: an index of signatures, a pairwise matcher, or a distance matrix."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import InputError, OptionError
from pcretrieve.retrieval.distances import Distance, pairwise
from pcretrieve.values import FloatArray, Neighbors

Positions = NDArray[np.intp]

# Number of distances that are in memory at once: 32 MB.
BLOCK_DISTANCES = 2**22


class DistanceBlock(NamedTuple):
    """Some rows of a distance matrix, so that the matrix need not be in memory as a whole.

    queries: (q,) intp, positions of the queries in the gallery.
    distances: (q, N) float64, distances from each query to every shape of the gallery, in the order of the
        gallery, the query itself included.
    """

    queries: Positions
    distances: FloatArray


class Ranking(Protocol):
    """A gallery of shapes and a distance, which need not be symmetric, from each of them to all."""

    @property
    def ids(self) -> Sequence[str]:
        """The gallery; identifiers are distinct."""

    def blocks(self, queries: Positions | None = None) -> Iterator[DistanceBlock]:
        """Distances from shapes of the gallery, by default from all, to all of the gallery."""

    def nearest(self, shape_id: str, k: int = 10) -> Neighbors:
        """The shapes nearest to a shape of the gallery, itself included."""


def pairwise_blocks(
    distance: str | Distance, gallery: FloatArray, queries: Positions
) -> Iterator[DistanceBlock]:
    """Distances from some signatures of a gallery (N, L) to all of them, a few queries at a time."""
    rows = max(1, BLOCK_DISTANCES // max(1, len(gallery)))
    for start in range(0, len(queries), rows):
        chunk = queries[start : start + rows]
        yield DistanceBlock(chunk, pairwise(distance, gallery[chunk], gallery))


def nearest_of(ids: Sequence[str], distances: FloatArray, k: int) -> Neighbors:
    """The nearest shapes by their distances (N,), which are not NaN."""
    k = checked_k(k)
    # Shapes as near as the k-th are candidates too: which of them come first is decided by their ids.
    limit = np.partition(distances, k - 1)[k - 1] if k < len(distances) else np.inf
    near: list[int] = np.flatnonzero(distances <= limit).tolist()
    rows = sorted(near, key=lambda row: (distances[row], ids[row]))[:k]
    return Neighbors(tuple(ids[row] for row in rows), distances[rows])


def checked_k(k: int, name: str = "k") -> int:
    """A number of neighbours, or of other things, after a check."""
    if isinstance(k, bool) or not isinstance(k, (int, np.integer)) or k < 1:
        raise OptionError(f"{name} must be a whole number of at least 1, got {k!r}")
    return int(k)


def position_of(ids: Sequence[str], shape_id: str) -> int:
    """The position of a shape in a gallery."""
    try:
        return ids.index(shape_id)
    except ValueError as error:
        raise InputError(
            f"the query must be one of the {len(ids)} ranked shapes, got {shape_id!r}"
        ) from error
