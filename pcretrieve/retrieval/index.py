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

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcretrieve.errors import InputError
from pcretrieve.options import RetrievalOptions
from pcretrieve.retrieval.distances import coordinates, pairwise, table_coordinates
from pcretrieve.retrieval.filtering import Filter
from pcretrieve.retrieval.fitting import fit_whitening
from pcretrieve.retrieval.lower_bounds import BLOCK
from pcretrieve.retrieval.names import Names
from pcretrieve.retrieval.ranking import (
    DistanceBlock,
    Positions,
    checked_k,
    nearest_of,
    pairwise_blocks,
    position_of,
)
from pcretrieve.retrieval.units import check_unit
from pcretrieve.retrieval.whitening import Whitening
from pcretrieve.types import FloatArray, Metric, Neighbors, Signature, SignatureTable, SizeUnit

__all__ = ["SignatureIndex"]

# Prefix of the names of the arrays of the whitening, among the arrays of an index.
WHITENING = "whitening_"

# Kind, digest and metric of the signatures, and the unit of their sizes, as in `SignatureTable`.
MadeBy: TypeAlias = "tuple[str, str, Metric, SizeUnit | None]"

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
        If the whitening ``resolution`` is asked for and was not made before.
    InputError
        If the table is empty, or the whitening was fitted on signatures with other options.
    """

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
        made_by = table.kind, table.digest, table.metric, table.unit
        whitening = whitening or fit_whitening(
            options.whitening, points, table.labels, shrinkage=options.shrinkage, options_digest=table.digest
        )
        self._fill(made_by, Names.of(table.ids[row] for row in by_id), points[by_id], options, whitening)

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
        made_by : tuple
            Kind, digest and metric of the signatures, and the unit of their sizes, as in `SignatureTable`.
        options : RetrievalOptions
            The distance, and the whitening to fit on `points`.
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
        index = cls.__new__(cls)
        whitening = whitening or fit_whitening(
            options.whitening, points, labels, shrinkage=options.shrinkage, options_digest=made_by[1]
        )
        index._fill(made_by, ids, points, options, whitening)
        return index

    def _fill(
        self,
        made_by: MadeBy,
        ids: Names,
        points: FloatArray,
        options: RetrievalOptions,
        whitening: Whitening,
    ) -> None:
        """Whiten coordinates in place, in the order of the ids, and bound their distances."""
        self._kind, self._digest, self._metric, self._unit = made_by
        whitening.check_made_for(self._digest)
        self.distance, self.whitening, self.ids = options.distance, whitening, ids
        for start in range(0, len(ids), BLOCK):
            block = slice(start, start + BLOCK)
            points[block] = whitening.apply(points[block])
        self._filter = Filter.of(self.distance, points)  # sorted by id: so are ties

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
        return self._nearest(self._filter.points[row : row + 1], checked_k(k))

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
        yield from pairwise_blocks(self.distance, self._filter.points, rows)

    def _nearest(self, point: FloatArray, k: int) -> Neighbors:
        """The `k` nearest neighbours of a (1, L) whitened log-signature."""
        candidates = self._filter.candidates(point, min(k, len(self)))
        distances = pairwise(self.distance, point, self._filter.points[candidates])[0]
        return nearest_of([self.ids[row] for row in candidates], distances, k)

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """The contents as arrays by name, none of which holds objects: the input of `from_arrays`."""
        arrays = self._filter.to_arrays()
        arrays |= {f"{WHITENING}{name}": array for name, array in self.whitening.to_arrays().items()}
        arrays |= {"id_text": self.ids.text, "id_ends": self.ids.ends}
        made_by = {"kind": self._kind, "digest": self._digest, "metric": self._metric}
        made_by["unit"] = self._unit or ""
        return arrays | {name: np.array(text) for name, text in made_by.items()}

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
        fitted = {name.removeprefix(WHITENING): a for name, a in arrays.items() if name.startswith(WHITENING)}
        index = cls.__new__(cls)
        try:
            index._kind, index._digest = str(arrays["kind"]), str(arrays["digest"])
            index._metric = cast("Metric", str(arrays["metric"]))
            index._unit = cast("SizeUnit", str(arrays["unit"])) or None
            index.ids = Names(arrays["id_text"], arrays["id_ends"])
            index._filter = Filter.from_arrays(arrays)
        except KeyError as error:
            raise InputError(f"the arrays of an index must include {error.args[0]!r}") from error
        index.distance, index.whitening = index._filter.distance, Whitening.from_arrays(fitted)
        if len(index.ids) != len(index._filter.points):
            raise InputError("the arrays of an index must be of one table, got several; build it again")
        return index

    def _checked_logs(self, signature: Signature | ArrayLike) -> FloatArray:
        """(L,) logarithms of a query, after checks that it is comparable with the table."""
        if isinstance(signature, Signature):
            if (signature.kind, signature.digest) != (self._kind, self._digest):
                raise InputError(
                    f"the query must be made by the same method and options as the table, "
                    f"{self._kind!r} {self._digest!r}, got {signature.kind!r} {signature.digest!r}"
                )
            check_unit(signature.unit, self._unit)
            signature = signature.values
        logs = coordinates(signature, self._metric)
        row = self._filter.points.shape[1:]
        if logs.shape != row:
            raise InputError(f"the query must have shape {row}, as the table's rows have, got {logs.shape}")
        return logs
