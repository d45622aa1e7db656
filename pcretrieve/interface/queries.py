"""Catalogue and queries → ranked shapes: `search` and `search_many`."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from pcretrieve import searching
from pcretrieve.descriptors import describe
from pcretrieve.errors import ShapeError
from pcretrieve.formats.scans import ScanLike
from pcretrieve.interface.catalogues import CatalogueLike, opened
from pcretrieve.matching import DistanceMatrix
from pcretrieve.options import OptionsLike, PipelineOptions
from pcretrieve.pages.query_page import write_query_page
from pcretrieve.pipeline.process import process
from pcretrieve.searching import Answer, Described
from pcretrieve.values import Neighbors, Signature

__all__ = ["query_page", "search", "search_many"]


def search(
    catalogue: CatalogueLike,
    query: ScanLike | Signature,
    *,
    k: int = 10,
    options: OptionsLike = None,
    matrix: DistanceMatrix | None = None,
    unit: str | None = None,
    labels: Collection[str] | None = None,
    exclude_self: bool = False,
    min_score: float | None = None,
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
    labels : collection of str, optional
        The classes whose shapes are searched; by default all shapes.
    exclude_self : bool, default False
        Whether a query that is a shape of the catalogue is left out of its own results.
    min_score : float, optional
        Least score of a result, between 0 and 1; no results then mean "no match". By default results have any
        score.

    Returns
    -------
    Neighbors
        Nearest first; equal distances by id. They have scores, the shares of pairs of one class among pairs
        that near, unless there is a `matrix`, or the catalogue has neither labels nor enough shapes.

    Raises
    ------
    CatalogueError
        If the options require other spectra than the catalogue has.
    InputError
        If the catalogue has no shapes, or none of these classes; or, with `matrix`, does not have this query;
        or if sizes are compared and one of the units, of the query and of the shapes, is known and the other
        is not.
    ShapeError
        If the scan cannot be read or has no usable surface.
    """
    with opened(catalogue) as store:
        chosen = PipelineOptions.of(options, store.options)
        if not isinstance(query, (str, Path, Signature)):
            own = store.options if unit is None else store.options.changed(scan={"unit": unit})
            made = describe(process(query, own), chosen.compared)
            query = replace(made, digest=chosen.compared_digest)
        return searching.search(
            store,
            query,
            k=k,
            options=chosen,
            matrix=matrix,
            unit=unit,
            labels=labels,
            exclude_self=exclude_self,
            min_score=min_score,
        )


def search_many(
    catalogue: CatalogueLike,
    queries: Iterable[str | Path | Signature],
    *,
    k: int = 10,
    options: OptionsLike = None,
    matrix: DistanceMatrix | None = None,
    unit: str | None = None,
    labels: Collection[str] | None = None,
    exclude_self: bool = False,
    min_score: float | None = None,
) -> Iterator[tuple[str, Answer | ShapeError]]:
    """Answer several queries, in their order.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The catalogue that is searched.
    queries : iterable of str, Path or Signature
        Each as in `search`, or a folder, which stands for all scans in it. A str that is the id of a shape is
        that shape, also if there is a folder of this name.
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

    Yields
    ------
    name : str
        The query: its path or its id, the path of each scan of a folder, or the kind of a signature.
    answer : Answer or ShapeError
        The neighbours and their records, or the error of a scan that cannot be read or has no usable surface.

    Raises
    ------
    CatalogueError
        If the options require other spectra than the catalogue has.
    InputError
        As by `search`, before the first answer.
    """
    with opened(catalogue) as store:
        yield from searching.search_many(
            store,
            queries,
            k=k,
            options=PipelineOptions.of(options, store.options),
            matrix=matrix,
            unit=unit,
            labels=labels,
            exclude_self=exclude_self,
            min_score=min_score,
        )


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
        outcomes = searching.search_many(
            store,
            [queries] if isinstance(queries, (str, Path)) else queries,
            k=k,
            options=chosen,
            matrix=matrix,
            unit=unit,
            labels=labels,
            exclude_self=exclude_self,
            min_score=min_score,
            describe_scans=partial(_pictured, up),
        )
        return write_query_page(
            path, store, outcomes, options=chosen, matrix=matrix, labels=labels, min_score=min_score, up=up
        )


def _pictured(
    up: str | None, scans: Sequence[Path], options: PipelineOptions
) -> Iterator[tuple[Path, Described | ShapeError]]:
    """The signatures and the pictures of scans, computed in this process."""
    for scan in scans:
        try:
            yield scan, searching.pictured(scan, options, up)
        except ShapeError as error:
            yield scan, error
