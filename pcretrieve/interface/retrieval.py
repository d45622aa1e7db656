"""Catalogue → a page of retrieval measures: `report`."""

from __future__ import annotations

from pathlib import Path

from pcretrieve.catalogue import Catalogue, CatalogueLike, opened
from pcretrieve.evaluation import result_scores
from pcretrieve.matching import DistanceMatrix
from pcretrieve.options import OptionsLike, PipelineOptions
from pcretrieve.pages.retrieval_page import MOST_QUERIES, retrieval_page


def report(
    catalogue: CatalogueLike,
    path: str | Path,
    *,
    n_queries: int = MOST_QUERIES,
    k: int = 5,
    options: OptionsLike = None,
    matrix: DistanceMatrix | None = None,
    versus: str | Path | Catalogue | None = None,
    up: str | None = None,
) -> Path:
    """Write a page with retrieval measures, and with pictures of queries and their ranked results.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The shapes.
    path : str or Path
        The HTML file.
    n_queries : int, default 1000
        Largest number of queries, those with the lowest average precision first.
    k : int, default 5
        Number of results of each query, without the query itself.
    options : OptionsLike, optional
        Signature, distance and whitening. By default the options of the catalogue.
    matrix : DistanceMatrix, optional
        Distances that replace the distances of signatures.
    versus : str, Path or Catalogue, optional
        Another result for the same shapes, with which the page compares query by query: a catalogue, or a
        file ``queries.csv`` of `Evaluation.write`.
    up : {"x", "-x", "y", "-y", "z", "-z"}, optional
        The axis of the files that points upwards on pictures; by default found for each shape.

    Returns
    -------
    Path
        Absolute path of the page.

    Raises
    ------
    InputError
        If the catalogue has no shapes, or the page cannot be written.
    CatalogueError
        If the options require other spectra than the catalogue has.
    """
    with opened(catalogue) as store:
        chosen = PipelineOptions.of(options, store.options)
        return retrieval_page(
            store,
            path,
            n_queries=n_queries,
            k=k,
            options=chosen,
            matrix=matrix,
            other=None if versus is None else result_scores(versus, lambda other: other.options),
            other_name=versus.location if isinstance(versus, Catalogue) else str(versus),
            up=up,
        )
