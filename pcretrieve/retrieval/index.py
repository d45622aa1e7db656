"""Exact k-nearest-neighbour search among many signatures, by filter and refinement [1]_.

A ball tree searches an embedding of the log-signatures in which distances are fast to compute and are lower
bounds of the exact distances. A query has three steps:

1. Filter: find the k shapes with the smallest lower bounds, and compute their exact distances. Let τ be the
   largest of them. At least k shapes are within τ of the query, so that each of the k nearest neighbours is.
2. Range query: find all shapes with a lower bound of at most τ. They include the k nearest neighbours,
   because a lower bound does not exceed the exact distance.
3. Refinement: sort these shapes by exact distance, equal distances by identifier.

The result is equal to that of comparing the query with every shape, bit for bit.

References
----------
.. [1] Korn, Sidiropoulos, Faloutsos, Siegel and Protopapas, "Fast nearest neighbor search in medical image
   databases", VLDB 1996.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcretrieve.errors import InputError, OptionError
from pcretrieve.options import RetrievalOptions
from pcretrieve.retrieval.distances import log_signatures, pairwise
from pcretrieve.retrieval.fitting import table_whitening
from pcretrieve.retrieval.whitening import Whitening
from pcretrieve.types import FloatArray, Neighbors, Signature, SignatureTable

__all__ = ["SignatureIndex"]

# Number of principal directions in which the tree searches. With fewer directions the lower bound is looser
# and more shapes need an exact distance; with more the tree prunes less. See docs/decisions.md, N_LEADING.
N_LEADING = 6

# Largest magnitude of a logarithm before exp, so that sums over a gallery stay finite in float64.
LARGEST_LOG = 300.0

# Tolerance of the lower bound. The rounding error of a sum of L products of numbers of magnitude s is at most
# a few L·s·ε; this is the factor of L·s.
ROUNDING = 64 * float(np.finfo(np.float64).eps)

Embedding = Callable[[FloatArray], FloatArray]


def _leading_directions(gallery: FloatArray, n_leading: int) -> tuple[str, Embedding]:
    """Coordinates along the first principal directions of the gallery, with the Euclidean distance.

    An orthogonal projection does not increase the Euclidean distance. The distance of the coordinates is
    therefore a lower bound of ``log``, and of ``d2``, since ``log`` ≤ ``d2``.

    Returns
    -------
    metric : str
        The metric of the embedding, by its name in `BallTree`.
    embedding : function
        The map from (n, L) log-signatures to (n, n_leading) coordinates.
    """
    mean = gallery.mean(axis=0)
    centred = gallery - mean
    _, directions = np.linalg.eigh(centred.T @ centred)  # variances ascend
    leading = directions[:, ::-1][:, :n_leading]  # (L, n_leading)
    return "euclidean", lambda logs: (logs - mean) @ leading


def _positive_values(gallery: FloatArray, n_leading: int) -> tuple[str, Embedding]:
    """Signature values, with the Canberra distance Σ |a − b| / (|a| + |b|), which equals ``d1``.

    The distance does not change if a value of all signatures is multiplied by one factor; subtracting the
    mean of the logarithms keeps exp in range. Clipping does not increase |x|, nor therefore tanh(|x| / 2):
    the distance of clipped values is a lower bound of ``d1``.

    Returns
    -------
    metric : str
        The metric of the embedding, by its name in `BallTree`.
    embedding : function
        The map from (n, L) log-signatures to (n, L) positive values.
    """
    mean = gallery.mean(axis=0)
    return "canberra", lambda logs: np.exp(np.clip(logs - mean, -LARGEST_LOG, LARGEST_LOG))


_EMBEDDINGS: Mapping[str, Callable[[FloatArray, int], tuple[str, Embedding]]] = MappingProxyType(
    {"log": _leading_directions, "d2": _leading_directions, "d1": _positive_values}
)


class SignatureIndex:
    """An exact k-nearest-neighbour index of a table of signatures.

    The index is built in memory from the table and not stored in the catalogue, because the pickle of a
    `BallTree` depends on the version of scikit-learn. See docs/decisions.md, SignatureIndex, for the time.

    Parameters
    ----------
    table : SignatureTable
        The gallery, at least one signature.
    options : RetrievalOptions, optional
        The distance, and the whitening to fit on `table`.
    whitening : Whitening, optional
        A whitening made before, such as `resolution_whitening`, instead of the one that `options` name.
    n_leading : int, default 6
        Number of principal directions in which the tree searches for ``log`` and ``d2``; it affects the time,
        not the result.

    Attributes
    ----------
    distance : str
        A key of `pcretrieve.retrieval.DISTANCES`.
    whitening : Whitening
        The whitening of the gallery and of all queries.

    Raises
    ------
    OptionError
        If `n_leading` is less than 1, or the whitening ``resolution`` is asked for and was not made before.
    InputError
        If the table is empty, or the whitening was fitted on signatures with other options.
    """

    def __init__(
        self,
        table: SignatureTable,
        options: RetrievalOptions | None = None,
        *,
        whitening: Whitening | None = None,
        n_leading: int = N_LEADING,
    ) -> None:
        from sklearn.neighbors import BallTree

        options = options or RetrievalOptions()
        if n_leading < 1:
            raise OptionError(f"n_leading must be at least 1, got {n_leading}")
        if not len(table):
            raise InputError("an index needs at least 1 shape, got an empty table; ingest shapes first")
        self.distance = options.distance
        self.whitening = table_whitening(table, options, whitening)
        self._kind, self._digest = table.kind, table.digest
        by_id = sorted(range(len(table)), key=table.ids.__getitem__)
        self._ids = tuple(table.ids[row] for row in by_id)
        self._gallery = self.whitening.apply(
            log_signatures(table.values[by_id])
        )  # (N, L), sorted by id: so are ties
        self._size = max(1.0, float(np.abs(self._gallery).max(initial=0)))
        metric, self._embed = _EMBEDDINGS[self.distance](self._gallery, n_leading)
        self._tree: Any = BallTree(self._embed(self._gallery), metric=metric)

    def __len__(self) -> int:
        return len(self._ids)

    def query(self, signature: Signature | ArrayLike, k: int = 10) -> Neighbors:
        """The `k` nearest neighbours of one signature, including the signature itself if it is in the table.

        Parameters
        ----------
        signature : Signature or (L,) array_like
            Signature values as in the table: positive, neither logarithms nor whitened.
        k : int, default 10
            Number of neighbours, at least 1. If the table has fewer shapes, all of them are returned.

        Returns
        -------
        Neighbors
            Nearest first; equal distances by identifier.

        Raises
        ------
        OptionError
            If `k` is not an integer of at least 1.
        InputError
            If the kind, the digest or the length of the signature is not that of the table, or a value is not
            positive and finite.
        """
        if isinstance(k, bool) or not isinstance(k, (int, np.integer)) or k < 1:
            raise OptionError(f"k must be a whole number of at least 1, got {k!r}")
        point = self.whitening.apply(self._checked_logs(signature)[np.newaxis])  # (1, L)
        candidates = self._candidates(point, min(int(k), len(self)))
        distances = pairwise(self.distance, point, self._gallery[candidates])[0]
        order = np.argsort(distances, kind="stable")[:k]
        ranked = distances[order]
        ranked.flags.writeable = False
        return Neighbors(tuple(self._ids[row] for row in candidates[order]), ranked)

    def query_many(self, signatures: Iterable[Signature | ArrayLike], k: int = 10) -> list[Neighbors]:
        """The nearest neighbours of each of Q signatures, in order.

        Parameters
        ----------
        signatures : iterable of Signature or (Q, L) array_like
            The queries, each as in `query`.
        k : int, default 10
            Number of neighbours of each query, at least 1.

        Returns
        -------
        list of Neighbors, length Q
            The result of `query` for each signature.
        """
        return [self.query(signature, k) for signature in signatures]

    def _candidates(self, point: FloatArray, k: int) -> NDArray[np.intp]:
        """Rows of the gallery, ascending, that include the `k` nearest and all rows at equal distance."""
        embedded = self._embed(point)
        bounds, rows = self._tree.query(embedded, k=min(k + 1, len(self)))  # (1, k + 1), ascending
        exact = pairwise(self.distance, point, self._gallery[rows[0]])[0]
        farthest = np.partition(exact, k - 1)[k - 1]
        size = max(self._size, float(np.abs(point).max(initial=0)))
        radius = farthest + ROUNDING * (farthest + size * point.shape[1])
        # If the largest lower bound found exceeds the radius, the bounds of all other shapes do too.
        if rows.shape[1] < len(self) and bounds[0, -1] <= radius:
            rows = self._tree.query_radius(embedded, radius)
        candidates: NDArray[np.intp] = np.sort(rows[0])
        return candidates

    def _checked_logs(self, signature: Signature | ArrayLike) -> FloatArray:
        """(L,) logarithms of a query, after checks that it is comparable with the table."""
        if isinstance(signature, Signature):
            if (signature.kind, signature.digest) != (self._kind, self._digest):
                raise InputError(
                    f"the query must be made by the same method and options as the table, "
                    f"{self._kind!r} {self._digest!r}, got {signature.kind!r} {signature.digest!r}"
                )
            signature = signature.values
        logs = log_signatures(signature)
        if logs.shape != (self._gallery.shape[1],):
            raise InputError(
                f"the query must have shape ({self._gallery.shape[1]},), as the table's rows have, "
                f"got {logs.shape}"
            )
        return logs
