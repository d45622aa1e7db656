"""Catalogue → neighbours, measures, distances and pages: `search`, `evaluate`, `matrix` and `report`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from pcretrieve.descriptors import describe
from pcretrieve.evaluation import (
    RetrievalMeasures,
    catalogue_distances,
    evaluate_rankings,
    rank_catalogue,
    rank_table,
)
from pcretrieve.evaluation import calibrate as calibrate_catalogue
from pcretrieve.formats.scans import ScanLike
from pcretrieve.interface.catalogues import CatalogueLike, opened
from pcretrieve.matching import DistanceMatrix
from pcretrieve.options import OptionsLike, PipelineOptions
from pcretrieve.pages.retrieval_page import retrieval_page
from pcretrieve.pipeline.process import process
from pcretrieve.searching import search as search_catalogue
from pcretrieve.types import Neighbors, Signature, SignatureTable

__all__ = ["calibrate", "evaluate", "matrix", "report", "search"]


def search(
    catalogue: CatalogueLike,
    query: ScanLike | Signature,
    *,
    k: int = 10,
    options: OptionsLike = None,
    matrix: DistanceMatrix | None = None,
    unit: str | None = None,
) -> Neighbors:
    """The shapes of a catalogue nearest to a scan.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The catalogue that is searched.
    query : ScanLike or Signature
        The file of a scan, which is processed with the options of the catalogue unless the catalogue has a
        shape of the same content; the id of a shape of the catalogue, as a str that is not the path of a
        file; an array or geometry, which is processed; or a signature that was made with the same options.
    k : int, default 10
        Number of shapes. If the catalogue has fewer, all of them are returned.
    options : OptionsLike, optional
        Signature, distance and whitening. By default the options of the catalogue.
    matrix : DistanceMatrix, optional
        Distances that replace the distances of signatures, for a query that the catalogue has.
    unit : str, optional
        Unit of the query (``um mm cm dm m km in ft``), if it does not have one itself; by default that of the
        options of the catalogue. Matters only if sizes are compared.

    Returns
    -------
    Neighbors
        Nearest first; equal distances by id.

    Raises
    ------
    CatalogueError
        If the options require other spectra than the catalogue has.
    InputError
        If the catalogue has no shapes; or, with `matrix`, does not have this query; or if sizes are compared
        and one of the units, of the query and of the shapes, is known and the other is not.
    ShapeError
        If the scan cannot be read or has no usable surface.
    """
    with opened(catalogue) as store:
        chosen = PipelineOptions.of(options, store.options)
        if not isinstance(query, (str, Path, Signature)):
            own = store.options if unit is None else store.options.changed(scan={"unit": unit})
            made = describe(process(query, own), chosen.compared)
            query = replace(made, digest=chosen.compared_digest)
        return search_catalogue(store, query, k=k, options=chosen, matrix=matrix, unit=unit)


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
        A label file, whose classes replace the classes of the catalogue.
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
    n_queries: int = 8,
    k: int = 5,
    options: OptionsLike = None,
    matrix: DistanceMatrix | None = None,
) -> Path:
    """Write a page with retrieval measures, and with pictures of queries and their ranked results.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The shapes.
    path : str or Path
        The HTML file.
    n_queries : int, default 8
        Largest number of queries: the first shape of each class, or the first shapes if there are no classes.
    k : int, default 5
        Number of results of each query, without the query itself.
    options : OptionsLike, optional
        Signature, distance and whitening. By default the options of the catalogue.
    matrix : DistanceMatrix, optional
        Distances that replace the distances of signatures.

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
        return retrieval_page(store, path, n_queries=n_queries, k=k, options=chosen, matrix=matrix)
