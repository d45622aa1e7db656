"""Catalogue and queries → a page of answers: `query_page`."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path

from pcretrieve.catalogue import CatalogueLike, opened
from pcretrieve.errors import ShapeError
from pcretrieve.matching import DistanceMatrix
from pcretrieve.options import OptionsLike, PipelineOptions
from pcretrieve.pages.query_page import write_query_page
from pcretrieve.query import Described, Question, answers, pictured
from pcretrieve.values import Signature

__all__ = ["query_page"]


def query_page(
    catalogue: CatalogueLike,
    queries: str | Path | Iterable[str | Path | Signature],
    path: str | Path,
    *,
    k: int = 10,
    options: OptionsLike = None,
    matrix: DistanceMatrix | None = None,
    unit: str | None = None,
    labels: Collection[str] | None = None,
    exclude_self: bool = False,
    min_score: float | None = None,
    up: str | None = None,
) -> Path:
    """Answer one or more queries on an HTML page, with pictures.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The catalogue that is searched.
    queries : str, Path, or iterable of str, Path or Signature
        As for `search_many`. Scans that fail are listed on the page, with the reasons.
    path : str or Path
        The HTML file. It needs no other file.
    k : int, default 10
        Number of shapes for each query. If the catalogue has fewer, all of them are returned.
    options : OptionsLike, optional
        Signature, distance and whitening. By default the options of the catalogue.
    matrix : DistanceMatrix, optional
        Distances that replace the distances of signatures, for queries that the catalogue has.
    unit : str, optional
        Unit of the files of the queries, as in `search`.
    labels : collection of str, optional
        The classes whose shapes are searched; by default all shapes.
    exclude_self : bool, default False
        Whether a query that is a shape of the catalogue is left out of its own results.
    min_score : float, optional
        Least score of a result, between 0 and 1; no results then mean "no match". By default results have any
        score.
    up : {"x", "-x", "y", "-y", "z", "-z"}, optional
        The axis of the files that points upwards on pictures; by default found for each shape.

    Returns
    -------
    Path
        Absolute path of the page.

    Raises
    ------
    CatalogueError
        If the options require other spectra than the catalogue has.
    InputError
        As by `search`, or if the page cannot be written.
    """
    with opened(catalogue) as store:
        chosen = PipelineOptions.of(options, store.options)
        question = Question(chosen, k, labels, exclude_self, min_score, unit, matrix)
        many = [queries] if isinstance(queries, (str, Path)) else queries
        outcomes = answers(store, many, question, partial(_pictured, up))
        return write_query_page(
            path, store, outcomes, options=chosen, matrix=matrix, labels=labels, min_score=min_score, up=up
        )


def _pictured(
    up: str | None, scans: Sequence[Path], options: PipelineOptions
) -> Iterator[tuple[Path, Described | ShapeError]]:
    """The signatures and the pictures of scans, computed in this process."""
    for scan in scans:
        try:
            yield scan, pictured(scan, options, up)
        except ShapeError as error:
            yield scan, error
