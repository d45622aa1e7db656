"""The nearest shapes of one query, and the answers to many."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pcretrieve.catalogue import Catalogue
from pcretrieve.errors import InputError, OptionError, PcretrieveError, ShapeError
from pcretrieve.options import PipelineOptions
from pcretrieve.retrieval import N_NEAR, nearest_among, nearest_of, position_of, reranked_neighbors
from pcretrieve.retrieval.fitting import LEAST_SHAPES
from pcretrieve.retrieval.ranking import checked_k
from pcretrieve.searching.answers import Answer
from pcretrieve.searching.queries import Described, Query, queries_of, query_of
from pcretrieve.types import Neighbors, Signature

if TYPE_CHECKING:
    from pcretrieve.matching import DistanceMatrix

__all__ = ["DescribeScans", "search", "search_many"]

DescribeScans = Callable[
    [Sequence[Path], PipelineOptions], Iterable["tuple[Path, Described | PcretrieveError]"]
]


def _described(
    scans: Sequence[Path], options: PipelineOptions
) -> Iterator[tuple[Path, Described | PcretrieveError]]:
    """The signatures of scans, computed in this process."""
    # Imported here, because shapes of the catalogue are found without the stages.
    from pcretrieve.pipeline.process import judged_signature

    for scan in scans:
        try:
            yield scan, Described(*judged_signature(scan, options))
        except ShapeError as error:
            yield scan, error


def search(
    catalogue: Catalogue,
    query: str | Path | Signature,
    *,
    k: int = 10,
    options: PipelineOptions | None = None,
    matrix: DistanceMatrix | None = None,
    unit: str | None = None,
    labels: Collection[str] | None = None,
    exclude_self: bool = False,
    min_score: float | None = None,
) -> Neighbors:
    """Find the shapes of a catalogue nearest to a scan, to one of its shapes, or to a signature.

    Parameters
    ----------
    catalogue : Catalogue
        The catalogue that is searched.
    query : str, Path or Signature
        The file of a scan, which is processed with the options of the catalogue unless the catalogue has a
        shape of the same content; the id of a shape of the catalogue, as a str that is not the path of a
        file; or a signature that was made with the same options as the signatures of the catalogue.
    k : int, default 10
        Number of shapes. If the catalogue has fewer, all of them are returned.
    options : PipelineOptions, optional
        Options with another descriptor, distance or whitening than the options of the catalogue, such as
        ``catalogue.options.changed(retrieval={"whitening": "pca"})``.
    matrix : DistanceMatrix, optional
        Distances that replace the distances of signatures, for a query that the catalogue has.
    unit : str, optional
        Unit of the file of the query, if its format does not have one, a key of `METRES`; by default that of
        the options of the catalogue. Matters only if sizes are compared.
    labels : collection of str, optional
        The classes whose shapes are searched; by default all shapes.
    exclude_self : bool, default False
        Whether a query that is a shape of the catalogue is left out of its own results.
    min_score : float, optional
        Least score of a result, between 0 and 1; there may be no results. By default results have any score.

    Returns
    -------
    Neighbors
        Nearest first; equal distances by identifier. A shape of the catalogue is its own neighbour. They have
        scores, unless there is a `matrix`, or the catalogue has neither labels nor enough shapes.

    Raises
    ------
    CatalogueError
        If `options` require other spectra than the catalogue has.
    InputError
        If the catalogue has no shapes, or none of these classes; if the query is neither a file nor the id of
        a shape; if sizes are compared, and the unit of the query is known and that of the shapes is not, or
        vice versa; or, with `matrix`, if the query is not in the catalogue.
    ShapeError
        If the scan cannot be read or has no usable surface.
    """
    options = options or catalogue.options
    terms = _Terms(catalogue, options, checked_k(k), matrix, unit, labels, exclude_self, min_score)
    asked = query_of(catalogue, query, is_converted=terms.is_converted)
    ((_, outcome),) = _resolved(terms, [asked], _described)
    if isinstance(outcome, ShapeError):
        raise outcome
    return terms.neighbors(outcome)


def search_many(
    catalogue: Catalogue,
    queries: Iterable[str | Path | Signature],
    *,
    k: int = 10,
    options: PipelineOptions | None = None,
    matrix: DistanceMatrix | None = None,
    unit: str | None = None,
    labels: Collection[str] | None = None,
    exclude_self: bool = False,
    min_score: float | None = None,
    describe_scans: DescribeScans = _described,
) -> Iterator[tuple[str, Answer | ShapeError]]:
    """Answer several queries, in their order.

    Parameters
    ----------
    catalogue : Catalogue
        The catalogue that is searched.
    queries : iterable of str, Path or Signature
        Each as in `search`, or a folder, which stands for all scans in it.
    k, options, matrix, unit, labels, exclude_self, min_score : object
        As in `search`.
    describe_scans : callable, optional
        Computes the signatures of scans that the catalogue does not have, with given options, in their order;
        by default in this process.

    Yields
    ------
    name : str
        The query: its path or its id, the path of each scan of a folder, or the kind of a signature.
    answer : Answer or ShapeError
        The answer, or the error of a scan that cannot be read or has no usable surface.

    Raises
    ------
    CatalogueError, InputError
        As by `search`.
    """
    options = options or catalogue.options
    terms = _Terms(catalogue, options, checked_k(k), matrix, unit, labels, exclude_self, min_score)
    asked = queries_of(catalogue, queries, is_converted=terms.is_converted)
    for name, outcome in _resolved(terms, asked, describe_scans):
        if isinstance(outcome, ShapeError):
            yield name, outcome
            continue
        found = terms.neighbors(outcome)
        yield name, Answer(found, tuple(catalogue.record(shape_id) for shape_id in found.ids))


def _resolved(
    terms: _Terms, queries: Sequence[Query], describe_scans: DescribeScans
) -> Iterator[tuple[str, str | Signature | ShapeError]]:
    """For each query the id of its shape, or its signature, or why it has none."""
    for query in queries:
        terms.check(query)
    scans = [query.of for query in queries if isinstance(query.of, Path)]
    described = iter(describe_scans(scans, terms.scan_options) if scans else ())
    for query in queries:
        if isinstance(query.of, Path):
            _, outcome = next(described)
            if isinstance(outcome, PcretrieveError) and not isinstance(outcome, ShapeError):
                raise outcome
            yield query.name, outcome if isinstance(outcome, ShapeError) else outcome.signature
        else:
            yield query.name, query.of


@dataclass(frozen=True)
class _Terms:
    """What is searched for every query."""

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
        among = None if self.labels is None else self._labelled(self.labels)
        held = query if isinstance(query, str) else None
        # A query that is left out of its results is one of them before.
        found = self._ranked(query, among, self.k + self.exclude_self)
        if self.min_score is not None and found.scores is None:
            raise InputError(
                "a least score needs calibrated scores, which are estimated from distances of signatures, of "
                f"labelled shapes or of {LEAST_SHAPES} or more: label shapes, or leave out the least score"
            )
        kept = [
            number
            for number, shape_id in enumerate(found.ids)
            if not (self.exclude_self and shape_id == held)
            and (self.min_score is None or found.scores is None or found.scores[number] >= self.min_score)
        ][: self.k]
        scores = None if found.scores is None else found.scores[kept]
        return Neighbors(tuple(found.ids[number] for number in kept), found.distances[kept], scores)

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
            raise InputError(
                f"no shape of {self.catalogue.location} is of the class {' or '.join(sorted(labels))}; "
                "`pcretrieve list` shows the classes"
            )
        return among
