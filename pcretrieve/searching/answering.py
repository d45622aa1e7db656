"""The nearest shapes of one query, and the answers to many."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pcretrieve.catalogue import Catalogue
from pcretrieve.errors import PcretrieveError, ShapeError
from pcretrieve.options import PipelineOptions
from pcretrieve.retrieval.ranking import checked_k
from pcretrieve.searching.answers import Answer
from pcretrieve.searching.queries import Described, Query, queries_of, query_of
from pcretrieve.searching.terms import Terms
from pcretrieve.values import Neighbors, Signature

if TYPE_CHECKING:
    from pcretrieve.matching import DistanceMatrix

__all__ = ["DescribeScans", "answer_to", "search", "search_many"]

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
    terms = Terms(catalogue, options, checked_k(k), matrix, unit, labels, exclude_self, min_score)
    asked = query_of(catalogue, query, is_converted=terms.is_converted)
    ((_, outcome),) = _resolved(terms, [asked], _described)
    if isinstance(outcome, ShapeError):
        raise outcome
    return terms.neighbors(outcome if isinstance(outcome, str) else outcome.signature)


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
    terms = Terms(catalogue, options, checked_k(k), matrix, unit, labels, exclude_self, min_score)
    asked = queries_of(catalogue, queries, is_converted=terms.is_converted)
    for name, outcome in _resolved(terms, asked, describe_scans):
        if isinstance(outcome, ShapeError):
            yield name, outcome
            continue
        yield name, terms.answer(outcome)


def answer_to(
    catalogue: Catalogue,
    query: str | Described,
    *,
    k: int = 10,
    options: PipelineOptions | None = None,
    labels: Collection[str] | None = None,
    exclude_self: bool = False,
    min_score: float | None = None,
) -> Answer:
    """Answer one query that is known already. No file is read, whatever the query is called."""
    terms = Terms(
        catalogue, options or catalogue.options, checked_k(k), None, None, labels, exclude_self, min_score
    )
    return terms.answer(query)


def _resolved(
    terms: Terms, queries: Sequence[Query], describe_scans: DescribeScans
) -> Iterator[tuple[str, str | Described | ShapeError]]:
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
            yield query.name, outcome
        else:
            yield query.name, query.of if isinstance(query.of, str) else Described(query.of)
