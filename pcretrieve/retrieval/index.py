"""Exact k-nearest-neighbour search among many signatures, by filter and refinement [1]_.

`pcretrieve.retrieval.bounds` leaves most shapes out by lower bounds of their distances; the others are
sorted by exact distance, equal distances by identifier. The result is that of comparing the query with every
shape, bit for bit.

References
----------
.. [1] Korn, Sidiropoulos, Faloutsos, Siegel and Protopapas, "Fast nearest neighbor search in medical image
   databases", VLDB 1996.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcretrieve.errors import InputError
from pcretrieve.options import RetrievalOptions
from pcretrieve.retrieval.bounds import LowerBounds, Rows
from pcretrieve.retrieval.distances import (
    CHUNK,
    Distance,
    DistanceBlock,
    Positions,
    check_comparable,
    checked_k,
    coordinates,
    known_distance,
    nearest_of,
    pairwise,
    pairwise_blocks,
    unknown_shape,
)
from pcretrieve.retrieval.reranking import N_NEAR, reranked_neighbors
from pcretrieve.retrieval.scores import MatchScores
from pcretrieve.retrieval.whitening import Whitening, table_whitening
from pcretrieve.values import (
    FloatArray,
    Metric,
    Neighbors,
    Signature,
    SignatureTable,
    SizeUnit,
)
from pcretrieve.values.base import check_type

# Largest number of shapes that are all compared with each query, which takes 2 ms. To find a few of them by
# lower bounds is faster from 1,000 on, but by compiled code, which takes a command a second to load.
N_ALL = 4000

# Between the ids of shapes in their array.
SEPARATOR = "\0"

# Tolerance of the lower bound. The rounding error of a sum of L products of numbers of magnitude s is at most
# a few L·s·ε, and that of a vector of up to L such sums √L times as large; this is the factor of L²·s.
ROUNDING = 64 * float(np.finfo(np.float64).eps)

# Prefixes of the names of the arrays of the whitening and of the scores, among all arrays.
WHITENING = "whitening_"
SCORES = "scores_"

# What is wrong with the unit of a query and that of the shapes.
WRONG_UNITS = {
    (
        "unknown",
        "m",
    ): "the shapes are in metres, the unit of the query is unknown; say the unit of the query "
    "by --unit (scan.unit)",
    (
        "m",
        "unknown",
    ): "the query is in metres, the unit of the shapes is unknown; ingest the shapes into a "
    "new catalogue with --unit (scan.unit)",
}
INSTEAD = "or compare the form alone (size_weight = 0, and the scale area)"


class _MadeBy(NamedTuple):
    """How the signatures of a table were made."""

    kind: str
    digest: str
    metric: Metric
    unit: SizeUnit | None

    def check(self, query: Signature) -> None:
        """InputError if a signature is not comparable with those of the table.

        Sizes are not converted, because scans whose unit is known are converted to metres when they are read.
        """
        if (query.kind, query.digest) != (self.kind, self.digest):
            raise InputError(
                f"signatures must be made by the same method and options as the table, "
                f"{self.kind!r} {self.digest!r}, got {query.kind!r} {query.digest!r}"
            )
        if wrong := WRONG_UNITS.get((str(query.unit), str(self.unit))):
            raise InputError(
                f"sizes must be in one unit to be compared: {wrong}, {INSTEAD}"
            )


class SignatureIndex:
    """An exact k-nearest-neighbour index of a table of signatures.

    Parameters
    ----------
    table : SignatureTable
        The gallery, at least one signature.
    options : RetrievalOptions, optional
        The distance, and the whitening to fit on `table`.
    whitening : Whitening, optional
        A whitening made before, such as of `lab calibrate`, instead of the one that `options` name.
    distance : Distance, optional
        A distance of one's own, instead of the one that `options` name.
    scores : MatchScores, optional
        The calibrated score of a distance, such as `fit_scores` estimates.

    Attributes
    ----------
    ids : tuple of str, length N
        The shapes of the table, in alphabetical order.
    points : (N, L) float64
        Their whitened coordinates.
    whitening : Whitening
        The whitening of the gallery and of all queries.
    scores : MatchScores or None
        The calibrated score of a distance; None if it was not estimated.

    Raises
    ------
    OptionError
        If the whitening ``people`` is asked for and was not made before.
    InputError
        If the table is empty, or the whitening was fitted on signatures with other options.
    """

    def __init__(
        self,
        table: SignatureTable,
        options: RetrievalOptions | None = None,
        *,
        whitening: Whitening | None = None,
        distance: Distance | None = None,
        scores: MatchScores | None = None,
    ) -> None:
        check_type("table", table, SignatureTable)
        if not len(table):
            raise InputError(
                "an index needs at least 1 shape, got an empty table; ingest shapes first"
            )
        options = options or RetrievalOptions()
        self._distance = distance or known_distance(options.distance)
        check_comparable(table, self._distance)
        self._made_by = _MadeBy(table.kind, table.digest, table.metric, table.unit)
        self.whitening = whitening or table_whitening(table, options)
        self.whitening.check_made_for(table.digest)
        self.scores = scores
        by_id = sorted(range(len(table)), key=table.ids.__getitem__)
        self.ids = tuple(table.ids[row] for row in by_id)
        self.points: FloatArray = np.empty(table.values.shape)
        for start in range(0, len(by_id), CHUNK):
            some = slice(start, start + CHUNK)
            logs = coordinates(table.values[by_id[some]], table.metric)
            self.points[some] = self.whitening.apply(logs)
        self._size = max(1.0, float(self.points.max()), -float(self.points.min()))
        is_large = len(table) > N_ALL and self._distance.exceeds_log
        self._bounds = LowerBounds.of(self.points) if is_large else None

    @property
    def distance(self) -> str:
        """The name of the distance."""
        return self._distance.name

    def __repr__(self) -> str:
        n_shapes, n_values = self.points.shape
        return (
            f"SignatureIndex({n_shapes} shapes of {n_values} values, distance {self.distance}, "
            f"whitening {self.whitening.kind})"
        )

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def reason(self) -> str:
        """What the scores are estimated from, in words."""
        return (
            self.scores.reason
            if self.scores
            else "none, because labels and shapes are too few"
        )

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
        point = self.point_of(signature)
        candidates = self._candidates(point, min(k, len(self)))
        distances = pairwise(self._distance, point, self.points[candidates])[0]
        # Candidates ascend, and so do their ids: a stable sort leaves equal distances in the ids' order.
        first = np.argsort(distances, kind="stable")[:k]
        return Neighbors(
            tuple(self.ids[row] for row in candidates[first]), distances[first]
        )

    def nearest(self, shape_id: str, k: int = 10) -> Neighbors:
        """The nearest neighbours of a shape of the table, itself included, as `query` gives them."""
        return self.query(shape_id, k)

    def ranked(
        self,
        query: str | Signature,
        k: int,
        *,
        among: Collection[str] | None = None,
        rerank: str = "none",
    ) -> Neighbors:
        """The `k` first results, or more, with their scores; of some shapes, all of which are compared."""
        # The neighbourhoods among which a list is sorted again need more shapes than asked for.
        most = k if rerank == "none" else max(k, N_NEAR)
        if among is None:
            found = self.query(query, most)
        else:
            known = sorted({*among} & {*self.ids})
            found = nearest_of(known, self.between(known, self.point_of(query))[0], most)
        results = found
        if rerank != "none":
            shape_id = query if isinstance(query, str) else None
            results = reranked_neighbors(found, self.between(found.ids), shape_id)
        if self.scores is None:
            return results
        score_of = dict(
            zip(found.ids, self.scores.of(found.distances).tolist(), strict=True)
        )
        return replace(
            results, scores=np.array([score_of[shape_id] for shape_id in results.ids])
        )

    def load(self) -> None:
        """Load the compiled code now, so that no later query waits for it."""
        self.nearest(self.ids[0], 1)

    def blocks(self, queries: Positions | None = None) -> Iterator[DistanceBlock]:
        """Distances from shapes of the table, positions (Q,) in `ids` or all, to the whole table."""
        rows = np.arange(len(self)) if queries is None else queries
        yield from pairwise_blocks(self._distance, self.points, rows)

    def between(self, ids: Sequence[str], points: FloatArray | None = None) -> FloatArray:
        """Distances (Q, m) of whitened coordinates (Q, L), or (m, m) of some shapes, to these shapes."""
        rows: FloatArray = self.points[[self._row(shape_id) for shape_id in ids]]
        return pairwise(self._distance, rows if points is None else points, rows)

    def point_of(self, query: str | Signature | ArrayLike) -> FloatArray:
        """The whitened coordinates (1, L) of a shape of the table, or of a signature that is comparable."""
        if isinstance(query, str):
            place = self._row(query)
            held: FloatArray = self.points[place : place + 1]
            return held
        if isinstance(query, Signature):
            self._made_by.check(query)
            query = query.values
        point = coordinates(query, self._made_by.metric)
        row = self.points.shape[1:]
        if point.shape != row:
            raise InputError(
                f"the query must have shape {row}, as the table's rows have, got {point.shape}"
            )
        return self.whitening.apply(point[np.newaxis])

    def _candidates(self, point: FloatArray, k: int) -> NDArray[np.intp]:
        """Rows, ascending, that include the `k` nearest to a point and all rows at equal distance."""
        if self._bounds is None:
            return np.arange(len(self.points))
        return self._bounds.candidates(point[0], k, partial(self._radius, point, k))

    def _row(self, shape_id: str) -> int:
        """The row of a shape."""
        row = bisect_left(self.ids, shape_id)
        if self.ids[row : row + 1] != (shape_id,):
            raise unknown_shape(self.ids, shape_id)
        return row

    def _radius(self, point: FloatArray, k: int, rows: Rows) -> float:
        """A radius within which at least `k` of some rows lie, rounding errors included."""
        if len(rows) < k:
            return math.inf
        exact = pairwise(self._distance, point, self.points[rows])[0]
        farthest = float(np.partition(exact, k - 1)[k - 1])
        size = max(self._size, float(np.abs(point).max(initial=0)))
        radius: float = farthest + ROUNDING * (farthest + size * point.shape[1] ** 2)
        return radius

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """The contents as arrays by name, none of which holds objects; they may be mapped into memory."""
        arrays = {
            "distance": np.array(self.distance),
            "gallery": self.points,
            "size": np.array(self._size),
            "ids": np.frombuffer(SEPARATOR.join(self.ids).encode(), np.uint8),
        }
        arrays |= {
            name: np.array(text or "") for name, text in self._made_by._asdict().items()
        }
        arrays |= {} if self._bounds is None else self._bounds._asdict()
        for prefix, value in ((WHITENING, self.whitening), (SCORES, self.scores)):
            stored = {} if value is None else value.to_arrays()
            arrays |= {f"{prefix}{name}": array for name, array in stored.items()}
        return arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> SignatureIndex:
        """The inverse of `to_arrays`; InputError if an array is missing or has the wrong shape."""
        fitted, scored = (
            {
                name.removeprefix(prefix): array
                for name, array in arrays.items()
                if name.startswith(prefix)
            }
            for prefix in (WHITENING, SCORES)
        )
        index = cls.__new__(cls)
        try:
            kind, digest, metric, unit = (str(arrays[name]) for name in _MadeBy._fields)
            index._made_by = _MadeBy(
                kind, digest, cast("Metric", metric), cast("SizeUnit", unit) or None
            )
            index.ids = tuple(str(arrays["ids"].data, "utf-8").split(SEPARATOR))
            index.points, index._size = arrays["gallery"], float(arrays["size"])
            index._distance = known_distance(str(arrays["distance"]))
            index.whitening = Whitening.from_arrays(fitted)
            index.scores = MatchScores.from_arrays(scored) if scored else None
            has_bounds = "codes" in arrays
            index._bounds = (
                LowerBounds(*map(arrays.__getitem__, LowerBounds._fields))
                if has_bounds
                else None
            )
        except KeyError as error:
            raise InputError(
                f"the arrays of an index must include {error.args[0]!r}"
            ) from error
        fits = index._bounds is None or index._bounds.fits(index.points)
        if not fits or len(index.ids) != len(index.points):
            raise InputError(
                "the arrays of an index must be of one table, got several; build it again"
            )
        return index
