"""What the queries of a search ask for, and the answer to one of them."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from pcretrieve.catalogue import Catalogue
from pcretrieve.errors import InputError, OptionError
from pcretrieve.options import PipelineOptions
from pcretrieve.retrieval import (
    N_NEAR,
    class_vote,
    nearest_among,
    nearest_of,
    position_of,
    rank_ranges,
    reranked_neighbors,
)
from pcretrieve.retrieval.neighbour_covariance import LEAST_SHAPES
from pcretrieve.searching.answers import Answer
from pcretrieve.searching.queries import Described, Query
from pcretrieve.suggestions import did_you_mean
from pcretrieve.values import FloatArray, Neighbors, Signature

if TYPE_CHECKING:
    from pcretrieve.matching import DistanceMatrix

__all__ = ["Terms"]

# Least number of shapes that could come before the results within the error bar of a query.
N_CANDIDATES = 50


@dataclass(frozen=True)
class Terms:
    """What every query of a search asks for, as the arguments of `pcretrieve.searching.search`."""

    catalogue: Catalogue
    options: PipelineOptions
    k: int
    matrix: DistanceMatrix | None
    unit: str | None
    labels: Collection[str] | None
    exclude_self: bool
    min_score: float | None

    def __post_init__(self) -> None:
        if self.min_score is not None and not 0 <= self.min_score <= 1:
            raise OptionError(f"min_score must be between 0 and 1, got {self.min_score}")

    @property
    def is_converted(self) -> bool:
        """Whether files are read in another unit than those of the catalogue."""
        return self.matrix is None and self.unit not in (None, self.catalogue.options.scan.unit)

    @property
    def scan_options(self) -> PipelineOptions:
        """The options by which a scan that the catalogue does not have is processed."""
        own = self.catalogue.options.model_copy(update={"signature": self.options.compared})
        return own if self.unit is None else own.changed(scan={"unit": self.unit})

    def check(self, query: Query) -> None:
        """InputError if a distance matrix is to rank a query that is no shape of the catalogue."""
        if self.matrix is not None and not isinstance(query.of, str):
            raise InputError(
                f"a distance matrix ranks shapes of {self.catalogue.location} only, which does not hold "
                f"{query.name}: leave out the matrix, or ingest the scan and make the matrix again"
            )

    def neighbors(self, query: str | Signature) -> Neighbors:
        """The results of the id of a shape of the catalogue, or of a signature."""
        return self._cut(self._without_itself(query, self.k))

    def answer(self, query: str | Described) -> Answer:
        """The results, their records, the vote, and the ranks within the error bar of the query."""
        held, signature = (query, query) if isinstance(query, str) else (None, query.signature)
        ranked = self.matrix is not None or self.options.retrieval.rerank != "none"
        wide = self._without_itself(signature, self.k if ranked else max(2 * self.k, N_CANDIDATES))
        found = self._cut(wide)
        records = tuple(self.catalogue.record(shape_id) for shape_id in found.ids)
        weights = np.ones(len(records)) if found.scores is None else found.scores
        voters = [None if record.id == held else record.label for record in records]
        ranges = None
        if not ranked:
            index = self.catalogue.index(self.options)
            deviation = self._deviation(query, len(index.whitening.mean))
            if deviation is not None:
                ranges = rank_ranges(index, signature, deviation, wide.ids)[: len(found)]
        return Answer(found, records, class_vote(voters, weights), ranges, query)

    def _deviation(self, query: str | Described, n_values: int) -> FloatArray | None:
        """(L,) error bar over the surfaces of a scan, or its uncertainty in equal parts; None if unknown."""
        if isinstance(query, str):
            verdict = self.catalogue.record(query).verdict
        else:
            verdict = query.verdict
            if query.signature.metric == "logarithms" and query.signature.deviation is not None:
                return query.signature.deviation
        return None if verdict is None else np.full(n_values, verdict.uncertainty / np.sqrt(n_values))

    def _without_itself(self, query: str | Signature, k: int) -> Neighbors:
        """The `k` first results, without the query if it is to be left out."""
        among = None if self.labels is None else self._labelled(self.labels)
        held = query if isinstance(query, str) else None
        # A query that is left out of its results is one of them before.
        found = self._ranked(query, among, k + self.exclude_self)
        if not self.exclude_self:
            return _some(found, range(min(k, len(found))))
        return _some(found, [row for row, name in enumerate(found.ids) if name != held][:k])

    def _cut(self, found: Neighbors) -> Neighbors:
        """The first results, as far as their scores are large enough."""
        if self.min_score is not None and found.scores is None:
            raise InputError(
                "a least score needs calibrated scores, which are estimated from distances of signatures, of "
                f"labelled shapes or of {LEAST_SHAPES} or more: label shapes, or leave out the least score"
            )
        rows = range(min(self.k, len(found)))
        if self.min_score is None or found.scores is None:
            return _some(found, rows)
        return _some(found, [row for row in rows if found.scores[row] >= self.min_score])

    def _ranked(self, query: str | Signature, among: Collection[str] | None, k: int) -> Neighbors:
        """The `k` first results, or more, among some shapes or all."""
        if self.matrix is not None and isinstance(query, str):
            row = self.matrix.values[position_of(self.matrix.ids, query)]
            chosen = [number for number, name in enumerate(self.matrix.ids) if among is None or name in among]
            return nearest_of([self.matrix.ids[number] for number in chosen], row[chosen], k)
        index, method = self.catalogue.index(self.options), self.options.retrieval.rerank
        # The neighbourhoods of the results, among which a list is sorted again, need more shapes than asked
        # for.
        most = k if method == "none" else max(k, N_NEAR)
        held = query if isinstance(query, str) else None
        if among is not None:
            found = nearest_among(index, index.contents.point_of(query), sorted(among), most)
        elif isinstance(query, str):
            found = index.nearest(query, most)
        else:
            found = index.query(query, most)
        ranked = reranked_neighbors(index, found, method, shape_id=held)
        if index.scores is None:
            return ranked
        score_of = dict(zip(found.ids, index.scores.of(found.distances).tolist(), strict=True))
        return replace(ranked, scores=np.array([score_of[shape_id] for shape_id in ranked.ids]))

    def _labelled(self, labels: Collection[str]) -> set[str]:
        among = set(self.catalogue.labelled(labels))
        if not among:
            known = {one.label for one in self.catalogue.origins() if one.label is not None}
            meant = did_you_mean(next(iter(labels)), known) if len(labels) == 1 else ""
            raise InputError(
                f"no shape of {self.catalogue.location} is of the class {' or '.join(sorted(labels))}; "
                f"`pcretrieve list` shows the classes{meant}"
            )
        return among


def _some(found: Neighbors, rows: Sequence[int]) -> Neighbors:
    """Some of the results, in their order."""
    chosen = list(rows)
    scores = None if found.scores is None else found.scores[chosen]
    return Neighbors(tuple(found.ids[row] for row in chosen), found.distances[chosen], scores)
