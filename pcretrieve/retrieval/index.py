"""Exact k-nearest-neighbour search among many signatures, by filter and refinement [1]_.

A query has three steps. The lower bounds are those of `pcretrieve.retrieval.lower_bounds`.

1. Compute a lower bound of the distance to every shape, and the exact distances to a few shapes with small
   bounds. Let τ be the k-th smallest of them: at least k shapes are within τ of the query, so that each of
   the k nearest neighbours is.
2. Filter: keep the shapes with a lower bound of at most τ. They include the k nearest neighbours, because a
   lower bound does not exceed the exact distance.
3. Refinement: sort these shapes by exact distance, equal distances by identifier.

The result is equal to that of comparing the query with every shape, bit for bit.

References
----------
.. [1] Korn, Sidiropoulos, Faloutsos, Siegel and Protopapas, "Fast nearest neighbor search in medical image
   databases", VLDB 1996.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcretrieve.errors import InputError, OptionError
from pcretrieve.options import RetrievalOptions
from pcretrieve.retrieval.distances import DISTANCES, coordinates, pairwise, table_coordinates
from pcretrieve.retrieval.fitting import fit_whitening
from pcretrieve.retrieval.lower_bounds import BLOCK, LowerBounds
from pcretrieve.retrieval.names import Names
from pcretrieve.retrieval.ranking import (
    DistanceBlock,
    Positions,
    checked_k,
    nearest_of,
    pairwise_blocks,
    position_of,
)
from pcretrieve.retrieval.whitening import Whitening
from pcretrieve.types import FloatArray, Metric, Neighbors, Signature, SignatureTable

__all__ = ["SignatureIndex"]

# Tolerance of the lower bound. The rounding error of a sum of L products of numbers of magnitude s is at most
# a few L·s·ε; this is the factor of L·s.
ROUNDING = 64 * float(np.finfo(np.float64).eps)

# Exact distances in the first step, relative to k, and the number of blocks of the table, relative to k, from
# each of which the shape with the smallest lower bound is taken. See docs/decisions.md, N_FIRST.
N_FIRST = 4
N_BLOCKS = 64

NO_SHAPES = "an index needs at least 1 shape, got an empty table; ingest shapes first"


class SignatureIndex:
    """An exact k-nearest-neighbour index of a table of signatures.

    Parameters
    ----------
    table : SignatureTable
        The gallery, at least one signature.
    options : RetrievalOptions, optional
        The distance, and the whitening to fit on `table`.
    whitening : Whitening, optional
        A whitening made before, such as `resolution_whitening`, instead of the one that `options` name.
    n_leading : int, optional
        Number of principal directions, or for ``d1`` of values, that the lower bounds are computed from; it
        affects the time, not the result.

    Attributes
    ----------
    ids : sequence of str, length N
        The shapes of the table, in alphabetical order.
    distance : str
        A name in `pcretrieve.retrieval.DISTANCES`.
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
        n_leading: int | None = None,
    ) -> None:
        options = options or RetrievalOptions()
        if n_leading is not None and n_leading < 1:
            raise OptionError(f"n_leading must be at least 1, got {n_leading}")
        if not len(table):
            raise InputError(NO_SHAPES)
        by_id = sorted(range(len(table)), key=table.ids.__getitem__)
        points = table_coordinates(table, options.distance)
        if whitening is None:
            whitening = _fitted(points, table.labels, table.digest, options)
        made_by = table.kind, table.digest, table.metric
        self._fill(
            made_by, Names.of(table.ids[row] for row in by_id), points, options, whitening, by_id, n_leading
        )

    @classmethod
    def of_coordinates(
        cls,
        ids: Sequence[str],
        points: FloatArray,
        labels: Sequence[str | None],
        *,
        kind: str,
        digest: str,
        metric: Metric,
        options: RetrievalOptions,
        whitening: Whitening | None = None,
    ) -> SignatureIndex:
        """The index of a large table, without the copies that a table makes of its values.

        Parameters
        ----------
        ids : sequence of str, length N
            At least one, distinct, in alphabetical order.
        points : (N, L) float64
            Coordinates of the signatures, as in `pcretrieve.retrieval.coordinates`.
        labels : sequence of (str or None), length N
            Classes, for a whitening that is fitted to them.
        kind, digest, metric : str
            As in `SignatureTable`.
        options : RetrievalOptions
            As in `SignatureIndex`.
        whitening : Whitening, optional
            As in `SignatureIndex`.

        Returns
        -------
        SignatureIndex
            It gives the answers of the index of the table.

        Raises
        ------
        InputError
            If there are no shapes, or the whitening was fitted on signatures with other options or cannot be
            fitted.
        """
        if not len(ids):
            raise InputError(NO_SHAPES)
        index = cls.__new__(cls)
        names = Names.of(ids)
        if whitening is None:
            whitening = _fitted(points, labels, digest, options)
        index._fill((kind, digest, metric), names, points, options, whitening)
        return index

    def _fill(
        self,
        made_by: tuple[str, str, Metric],
        ids: Names,
        points: FloatArray,
        options: RetrievalOptions,
        whitening: Whitening,
        rows: Sequence[int] | None = None,
        n_leading: int | None = None,
    ) -> None:
        """Whiten the coordinates, of the shapes of `ids` in the given rows, and bound their distances."""
        self._kind, self._digest, self._metric = made_by
        whitening.check_made_for(self._digest)
        self.distance, self.whitening, self.ids = options.distance, whitening, ids
        order = np.arange(len(ids)) if rows is None else np.array(rows)
        self._gallery: FloatArray = np.empty(points.shape)  # (N, L), sorted by id: so are ties
        for start in range(0, len(ids), BLOCK):
            block = slice(start, start + BLOCK)
            self._gallery[block] = whitening.apply(points[order[block]])
        self._size = max(1.0, float(self._gallery.max()), -float(self._gallery.min()))
        bound = DISTANCES[self.distance].at_least
        self._bounds = LowerBounds.of(bound, self._gallery, n_leading) if bound else None

    def __len__(self) -> int:
        return len(self.ids)

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
        k = checked_k(k)
        return self._nearest(self.whitening.apply(self._checked_logs(signature)[np.newaxis]), k)

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

    def nearest(self, shape_id: str, k: int = 10) -> Neighbors:
        """The nearest neighbours of a shape of the table, itself included.

        Parameters
        ----------
        shape_id : str
            One of `ids`.
        k : int, default 10
            Number of neighbours, at least 1. If the table has fewer shapes, all of them are returned.

        Returns
        -------
        Neighbors
            Nearest first; equal distances by identifier.
        """
        row = position_of(self.ids, shape_id)
        return self._nearest(self._gallery[row : row + 1], checked_k(k))

    def blocks(self, queries: Positions | None = None) -> Iterator[DistanceBlock]:
        """Distances from shapes of the table to the whole table.

        Parameters
        ----------
        queries : (Q,) intp, optional
            Positions in `ids`. By default all.

        Yields
        ------
        DistanceBlock
            Some of the queries.
        """
        rows = np.arange(len(self)) if queries is None else queries
        yield from pairwise_blocks(self.distance, self._gallery, rows)

    def _nearest(self, point: FloatArray, k: int) -> Neighbors:
        """The `k` nearest neighbours of a (1, L) whitened log-signature."""
        candidates = self._candidates(point, min(k, len(self)))
        distances = pairwise(self.distance, point, self._gallery[candidates])[0]
        return nearest_of([self.ids[row] for row in candidates], distances, k)

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """The contents of the index as arrays, for `numpy.save`; none has the dtype object.

        Returns
        -------
        dict of str to array
            The input of `from_arrays`. The large arrays are ``gallery``, (N, L), and ``coordinates``.
        """
        whitening = {f"whitening_{name}": array for name, array in self.whitening.to_arrays().items()}
        return whitening | {
            "kind": np.array(self._kind),
            "metric": np.array(self._metric),
            "digest": np.array(self._digest),
            "distance": np.array(self.distance),
            "id_text": self.ids.text,
            "id_ends": self.ids.ends,
            "gallery": self._gallery,
            "size": np.array(self._size),
            **({} if self._bounds is None else self._bounds.to_arrays()),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> SignatureIndex:
        """The index that `to_arrays` has written as arrays.

        Parameters
        ----------
        arrays : mapping of str to array
            The arrays, which are not copied and may be mapped into memory.

        Returns
        -------
        SignatureIndex
            It gives the answers of the index before.

        Raises
        ------
        InputError
            If an array is missing or has the wrong shape.
        """
        index = cls.__new__(cls)
        try:
            index._kind, index._digest = str(arrays["kind"]), str(arrays["digest"])
            index.distance = RetrievalOptions(distance=str(arrays["distance"])).distance
            index.whitening = Whitening.from_arrays(
                {
                    name.removeprefix("whitening_"): a
                    for name, a in arrays.items()
                    if name.startswith("whitening_")
                }
            )
            index.ids = Names(arrays["id_text"], arrays["id_ends"])
            index._gallery, index._size = arrays["gallery"], float(arrays["size"])
            index._metric = cast("Metric", str(arrays["metric"]))
            bound = DISTANCES[index.distance].at_least
            index._bounds = LowerBounds.from_arrays(bound, arrays) if bound else None
        except KeyError as error:
            raise InputError(f"the arrays of an index must include {error.args[0]!r}") from error
        n, n_values = index._gallery.shape
        bounded = (n, n_values) if index._bounds is None else index._bounds.table_shape
        if (len(index.ids), n, n_values) != (n, *bounded):
            raise InputError("the arrays of an index must be of one table, got several; build it again")
        return index

    def _candidates(self, point: FloatArray, k: int) -> NDArray[np.intp]:
        """Rows of the gallery, ascending, that include the `k` nearest and all rows at equal distance."""
        if self._bounds is None:
            return np.arange(len(self))
        bounds = self._bounds.to(point[0])  # (N,)
        # The smallest bound of each of many blocks is found faster than the smallest bounds of the table.
        length = max(1, len(self) // (N_BLOCKS * k))
        n_blocks = len(self) // length
        best = bounds[: n_blocks * length].reshape(n_blocks, length).argmin(axis=1)
        radius = self._radius(point, k, bounds, best + length * np.arange(n_blocks))
        rows = np.flatnonzero(~(bounds > self._bounds.limit(point[0], radius)))
        # Neighbours in one block were missed by the first step: the rows that are left include them.
        radius = min(radius, self._radius(point, k, bounds, rows))
        return rows[~(bounds[rows] > self._bounds.limit(point[0], radius))]

    def _radius(
        self, point: FloatArray, k: int, bounds: NDArray[np.float32], rows: NDArray[np.intp]
    ) -> float:
        """A radius within which at least `k` of some rows lie, rounding errors included."""
        n = min(N_FIRST * k, len(rows))
        first = rows[np.argpartition(bounds[rows], n - 1)[:n]]
        exact = pairwise(self.distance, point, self._gallery[first])[0]
        farthest = float(np.partition(exact, k - 1)[k - 1])
        size = max(self._size, float(np.abs(point).max(initial=0)))
        radius: float = farthest + ROUNDING * (farthest + size * point.shape[1])
        return radius

    def _checked_logs(self, signature: Signature | ArrayLike) -> FloatArray:
        """(L,) logarithms of a query, after checks that it is comparable with the table."""
        if isinstance(signature, Signature):
            if (signature.kind, signature.digest) != (self._kind, self._digest):
                raise InputError(
                    f"the query must be made by the same method and options as the table, "
                    f"{self._kind!r} {self._digest!r}, got {signature.kind!r} {signature.digest!r}"
                )
            signature = signature.values
        logs = coordinates(signature, self._metric)
        if logs.shape != (self._gallery.shape[1],):
            raise InputError(
                f"the query must have shape ({self._gallery.shape[1]},), as the table's rows have, "
                f"got {logs.shape}"
            )
        return logs


def _fitted(
    points: FloatArray, labels: Sequence[str | None], digest: str, options: RetrievalOptions
) -> Whitening:
    """The whitening that the options ask for, fitted to coordinates."""
    return fit_whitening(options.whitening, points, labels, damping=options.damping, options_digest=digest)
