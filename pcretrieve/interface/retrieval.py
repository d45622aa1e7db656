"""Catalogue → measures, whitenings, distances and pages: `evaluate`, `compare`, `matrix` and so on."""

from __future__ import annotations

from pathlib import Path

from pcretrieve.catalogue import Catalogue
from pcretrieve.evaluation import (
    Comparison,
    QueryScores,
    RetrievalMeasures,
    catalogue_distances,
    compare_scores,
    evaluate_rankings,
    rank_catalogue,
    rank_table,
    result_scores,
)
from pcretrieve.evaluation import calibrate as calibrate_catalogue
from pcretrieve.interface.catalogues import CatalogueLike, opened
from pcretrieve.matching import DistanceMatrix
from pcretrieve.options import OptionsLike, PipelineOptions
from pcretrieve.pages.retrieval_page import MOST_QUERIES, retrieval_page
from pcretrieve.values import SignatureTable

__all__ = ["calibrate", "compare", "evaluate", "matrix", "report"]


def evaluate(
    shapes: CatalogueLike | SignatureTable,
    *,
    options: OptionsLike = None,
    labels: str | Path | None = None,
    matrix: DistanceMatrix | None = None,
    sound_only: bool = False,
) -> RetrievalMeasures:
    """Retrieval measures of labelled shapes, each of which is a query in all other shapes.

    Parameters
    ----------
    shapes : Catalogue, str, Path or SignatureTable
        A catalogue, whose failed shapes count as misses, or a table of signatures with labels.
    options : OptionsLike, optional
        Signature, distance and whitening. By default the options of the catalogue.
    labels : str or Path, optional
        A label file or the name of a layout, whose classes replace the classes of the catalogue.
    matrix : DistanceMatrix, optional
        Distances that replace the distances of signatures.
    sound_only : bool, default False
        Leave out the shapes of a catalogue whose verdict is "doubtful" or "unusable".

    Returns
    -------
    RetrievalMeasures
        Nearest neighbour (NN), first and second tier (FT, ST), E-measure (E), discounted cumulative gain
        (DCG) and mean average precision (mAP), each between 0 and 1.

    Raises
    ------
    BenchmarkError
        If no shape has a class, or no class two shapes.
    CatalogueError
        If the options require other spectra than the catalogue has.
    """
    if isinstance(shapes, SignatureTable):
        return evaluate_rankings(rank_table(shapes, PipelineOptions.of(options).retrieval))
    with opened(shapes) as store:
        chosen = PipelineOptions.of(options, store.options)
        return evaluate_rankings(
            rank_catalogue(store, chosen, labels=labels, matrix=matrix, sound_only=sound_only).rankings
        )


def compare(
    first: CatalogueLike | DistanceMatrix,
    second: CatalogueLike | DistanceMatrix,
    *,
    options: OptionsLike = None,
    second_options: OptionsLike = None,
    labels: str | Path | None = None,
) -> Comparison:
    """Compare two results for the same labelled shapes, query by query.

    Parameters
    ----------
    first : Catalogue, str, Path or DistanceMatrix
        A catalogue; a distance matrix, or its file; or a file ``queries.csv`` of
        `pcretrieve.evaluation.write_evaluation`.
    second : Catalogue, str, Path or DistanceMatrix
        The other result, which may be the same catalogue.
    options : OptionsLike, optional
        Signature, distance, whitening and re-ranking. By default the options of each catalogue.
    second_options : OptionsLike, optional
        Those of the second catalogue, if they differ.
    labels : str or Path, optional
        A label file, whose classes replace those of the catalogues, and which distance matrices need.

    Returns
    -------
    Comparison
        The differences of the measures, second minus first, with paired confidence intervals, and the shapes
        by how much their average precision changes.

    Raises
    ------
    BenchmarkError
        If no shape has a class, or no class two shapes.
    CatalogueError
        If a catalogue does not exist, or the options require other spectra than it has.
    InputError
        If a file cannot be read, or the results have no query in common.
    """

    def scores(result: CatalogueLike | DistanceMatrix, own: OptionsLike) -> QueryScores:
        return result_scores(result, lambda store: PipelineOptions.of(own, store.options), labels)

    return compare_scores(
        scores(first, options), scores(second, options if second_options is None else second_options)
    )


def calibrate(catalogue: CatalogueLike, path: str | Path, *, options: OptionsLike = None) -> Path:
    """Learn from labelled scans what to ignore, for other catalogues.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        Labelled shapes, such as three people in ten poses.
    path : str or Path
        The file of the whitening. ``{"retrieval": {"calibration": path}}`` are the options of a search in
        another catalogue that uses it.
    options : OptionsLike, optional
        Signature and shrinkage. By default the options of the catalogue.

    Returns
    -------
    Path
        Absolute path of the file.

    Raises
    ------
    CatalogueError
        If the options require other spectra than the catalogue has.
    InputError
        If no class has two distinct shapes, or the file cannot be written.
    """
    with opened(catalogue) as store:
        calibrate_catalogue(store, path, PipelineOptions.of(options, store.options))
    return Path(path).absolute()


def matrix(
    catalogue: CatalogueLike, *, options: OptionsLike = None, matcher: str | None = None
) -> DistanceMatrix:
    """All distances between the shapes of a catalogue that did not fail.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The shapes. Shapes to which the matcher cannot be applied are left out.
    options : OptionsLike, optional
        Signature, distance and whitening. By default the options of the catalogue.
    matcher : str, optional
        A method such as ``heat-hausdorff``, which compares pairs of shapes without signatures.

    Returns
    -------
    DistanceMatrix
        Row i has the distances from shape i, as a query, to all shapes.

    Raises
    ------
    CatalogueError
        If the options require other spectra than the catalogue has.
    InputError
        If the catalogue has no shapes.
    OptionError
        If there is no such matcher.
    """
    with opened(catalogue) as store:
        return catalogue_distances(store, PipelineOptions.of(options, store.options), matcher=matcher).matrix


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
        file ``queries.csv`` of `pcretrieve.evaluation.write_evaluation`.
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
