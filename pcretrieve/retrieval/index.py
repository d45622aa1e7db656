"""Exact k-nearest-neighbour search among many signatures, by filter and refinement [1]_.

`pcretrieve.retrieval.filtering` leaves most shapes out by lower bounds of their distances; the others are
sorted by exact distance, equal distances by identifier. The result is that of comparing the query with every
shape, bit for bit.

References
----------
.. [1] Korn, Sidiropoulos, Faloutsos, Siegel and Protopapas, "Fast nearest neighbor search in medical image
   databases", VLDB 1996.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcretrieve.errors import InputError
from pcretrieve.options import RetrievalOptions
from pcretrieve.retrieval import interpreted
from pcretrieve.retrieval.distances import pairwise, table_coordinates
from pcretrieve.retrieval.fitting import fit_whitening
from pcretrieve.retrieval.names import Names
from pcretrieve.retrieval.ranking import (
    DistanceBlock,
    Positions,
    checked_count,
    checked_k,
    pairwise_blocks,
    position_of,
)
from pcretrieve.retrieval.scores import MatchScores
from pcretrieve.retrieval.whitened import MadeBy, WhitenedTable
from pcretrieve.retrieval.whitening import Whitening
from pcretrieve.values import FloatArray, Neighbors, Signature, SignatureTable

__all__ = ["SignatureIndex"]

# Number of queries that an index answers without compiled code: numba takes longer to load than they take.
# See docs/decisions.md, N_INTERPRETED.
N_INTERPRETED = 10

NO_SHAPES = "an index needs at least 1 shape, got an empty table; ingest shapes first"


class SignatureIndex:
    """An exact k-nearest-neighbour index of a table of signatures.

    Parameters
    ----------
    table : SignatureTable
        The gallery, at least one signature.
    options : RetrievalOptions, optional
        The distance, the whitening to fit on `table`, and how the nearest are found.
    whitening : Whitening, optional
        A whitening made before, such as `resolution_whitening`, instead of the one that `options` name.

    Attributes
    ----------
    contents : WhitenedTable
        The whitened coordinates. Neighbours are found by blocks of neighbouring shapes, or, among few shapes
        and for distances without lower bounds, by all distances, or as `options` say: ``repr`` says how.

    Raises
    ------
    OptionError
        If the whitening ``resolution`` is asked for and was not made before, or the search that `options`
        name does not find neighbours by their distance.
    InputError
        If the table is empty, the whitening was fitted on signatures with other options, or a package that
        `options` name is not installed.
    """

    # Counted without a lock: two threads that count the same query change no answer.
    _n_answered = 0

    def __init__(
        self,
        table: SignatureTable,
        options: RetrievalOptions | None = None,
        *,
        whitening: Whitening | None = None,
    ) -> None:
        options = options or RetrievalOptions()
        if not len(table):
            raise InputError(NO_SHAPES)
        by_id = sorted(range(len(table)), key=table.ids.__getitem__)
        points = table_coordinates(table, options.distance)
        made_by = MadeBy(table.kind, table.digest, table.metric, table.unit)
        whitening = whitening or fit_whitening(
            options.whitening,
            points,
            table.labels,
            shrinkage=options.shrinkage,
            metric=table.metric,
            options_digest=table.digest,
        )
        ids = Names.of(table.ids[row] for row in by_id)
        self.contents = WhitenedTable.of(
            made_by, ids, points[by_id], options.distance, whitening, options.nearest
        )

    @classmethod
    def of_coordinates(
        cls,
        ids: Names,
        points: FloatArray,
        labels: Sequence[str | None],
        made_by: MadeBy,
        options: RetrievalOptions,
        whitening: Whitening | None = None,
    ) -> SignatureIndex:
        """The index of a large table, without the copies that a table makes of its values.

        Parameters
        ----------
        ids : Names, length N
            At least one, distinct.
        points : (N, L) float64
            Coordinates of the signatures, as in `pcretrieve.retrieval.coordinates`. They are overwritten, and
            become part of the index.
        labels : sequence of (str or None), length N
            Classes; needed only for a whitening that is fitted to them.
        made_by : MadeBy
            Kind, digest and metric of the signatures, and the unit of their sizes, as in `SignatureTable`.
        options : RetrievalOptions
            The distance, the whitening to fit on `points`, and how the nearest are found.
        whitening : Whitening, optional
            A whitening made before, as in `SignatureIndex`.

        Returns
        -------
        SignatureIndex
            It gives the answers of the index of the table.

        Raises
        ------
        InputError
            If there are no shapes, or the whitening was made for other options or cannot be fitted.
        """
        if not len(ids):
            raise InputError(NO_SHAPES)
        whitening = whitening or fit_whitening(
            options.whitening,
            points,
            labels,
            shrinkage=options.shrinkage,
            metric=made_by.metric,
            options_digest=made_by.digest,
        )
        return cls.of_contents(
            WhitenedTable.of(made_by, ids, points, options.distance, whitening, options.nearest)
        )

    @classmethod
    def of_contents(cls, contents: WhitenedTable) -> SignatureIndex:
        """The index of coordinates that are whitened already."""
        index = cls.__new__(cls)
        index.contents = contents
        return index

    @property
    def ids(self) -> Names:
        """The shapes of the table, in alphabetical order."""
        return self.contents.ids

    @property
    def distance(self) -> str:
        """A name in `pcretrieve.retrieval.DISTANCES`."""
        return self.contents.filter.distance

    @property
    def whitening(self) -> Whitening:
        """The whitening of the gallery and of all queries."""
        return self.contents.whitening

    @property
    def scores(self) -> MatchScores | None:
        """The calibrated score of a distance; None if it was not estimated (see `fit_scores`)."""
        return self.contents.scores

    def scored(self, scores: MatchScores | None) -> SignatureIndex:
        """The index with scores of distances, such as `fit_scores` estimates."""
        return self.of_contents(replace(self.contents, scores=scores))

    def __repr__(self) -> str:
        n_shapes, n_values = self.contents.filter.points.shape
        return (
            f"SignatureIndex({n_shapes} shapes of {n_values} values, distance {self.distance}, "
            f"whitening {self.whitening.kind}: {self.contents.filter})"
        )

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
            If the kind, the digest, the unit or the length of the signature is not that of the table, or a
            value is not positive and finite.
        """
        k = checked_k(k)
        return self._nearest(self.contents.point_of(signature), k)

    def query_many(
        self, signatures: Iterable[Signature | ArrayLike], k: int = 10, *, n_threads: int = 1
    ) -> list[Neighbors]:
        """The nearest neighbours of each of Q signatures, in order.

        Parameters
        ----------
        signatures : iterable of Signature or (Q, L) array_like
            The queries, each as in `query`.
        k : int, default 10
            Number of neighbours of each query, at least 1.
        n_threads : int, default 1
            Number of queries that are answered at a time, at least 1.

        Returns
        -------
        list of Neighbors, length Q
            The result of `query` for each signature.
        """
        with ThreadPoolExecutor(checked_count("n_threads", n_threads)) as threads:
            return list(threads.map(partial(self.query, k=k), signatures))

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
        return self._nearest(self.contents.filter.points[row : row + 1], checked_k(k))

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
        yield from pairwise_blocks(self.distance, self.contents.filter.points, rows)

    def between(self, ids: Sequence[str]) -> FloatArray:
        """Distances between some shapes of the table.

        Parameters
        ----------
        ids : sequence of str, length m
            The shapes, which are in `ids`.

        Returns
        -------
        (m, m) float64
            The distance from each of them to each.

        Raises
        ------
        InputError
            If the table does not have one of the shapes.
        """
        points = self.contents.filter.points[[position_of(self.ids, shape_id) for shape_id in ids]]
        return pairwise(self.distance, points, points)

    def _nearest(self, point: FloatArray, k: int) -> Neighbors:
        """The `k` nearest neighbours of a (1, L) whitened log-signature."""
        candidates = self.contents.filter.candidates(point, min(k, len(self)), self._scan())
        distances = pairwise(self.distance, point, self.contents.filter.points[candidates])[0]
        # Candidates ascend, and so do their ids: a stable sort leaves equal distances in the ids' order.
        first = np.argsort(distances, kind="stable")[:k]
        return Neighbors(tuple(self.ids[row] for row in candidates[first]), distances[first])

    def _scan(self) -> Callable[..., int]:
        """The scan of the blocks, compiled once that is worth the time that numba needs to load it."""
        self._n_answered += 1
        if self._n_answered <= N_INTERPRETED:
            return interpreted.scan
        from pcretrieve.retrieval.compiled import scan

        return scan

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """The contents as arrays by name, none of which holds objects: the input of `from_arrays`."""
        return self.contents.to_arrays()

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> SignatureIndex:
        """The index that `to_arrays` has written as arrays, which may be mapped into memory.

        Parameters
        ----------
        arrays : mapping of str to array
            The arrays, which are not copied.

        Returns
        -------
        SignatureIndex
            It gives the answers of the index before.

        Raises
        ------
        InputError
            If an array is missing or has the wrong shape.
        """
        return cls.of_contents(WhitenedTable.from_arrays(arrays))
