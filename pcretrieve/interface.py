"""The commands of the command line as functions, with the same names, defaults and numbers.

A catalogue may be given as a `Catalogue` or as the path of its file, options as in `PipelineOptions.of`, and
a scan as a path, an array, or geometry of this package or another.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

from pcretrieve.catalogue import Catalogue, Record
from pcretrieve.conversion import as_cloud
from pcretrieve.descriptors import describe
from pcretrieve.evaluation import (
    RetrievalMeasures,
    catalogue_distances,
    evaluate_rankings,
    rank_catalogue,
    rank_table,
)
from pcretrieve.formats.scans import ScanLike, as_scan
from pcretrieve.ingestion import Executor
from pcretrieve.ingestion.discover import discover
from pcretrieve.ingestion.labels import read_labels
from pcretrieve.ingestion.run import Summary, ingest_files
from pcretrieve.ingestion.views import read_views
from pcretrieve.inspection import Inspection, inspect_scan
from pcretrieve.matching import DistanceMatrix
from pcretrieve.options import MergeOptions, OptionsLike, PipelineOptions
from pcretrieve.pages.inspection_page import write_inspection_page
from pcretrieve.pages.retrieval_page import retrieval_page
from pcretrieve.pipeline.process import process
from pcretrieve.registration import Merged
from pcretrieve.registration import merge_views as merge_clouds
from pcretrieve.searching import search as search_catalogue
from pcretrieve.types import Neighbors, Signature, SignatureTable

__all__ = ["CatalogueLike", "evaluate", "ingest", "inspect", "matrix", "merge_views", "report", "search"]

#: A catalogue, or the path of its file.
CatalogueLike: TypeAlias = "Catalogue | str | Path"


def ingest(
    paths: str | Path | Sequence[str | Path],
    catalogue: CatalogueLike,
    *,
    labels: str | Path | Mapping[str, str] | None = None,
    options: OptionsLike = None,
    workers: int | None = None,
    timeout: float = 600.0,
    memory: float | None = None,
    executor: Executor | str = "processes",
    retry_failed: bool = False,
    on_shape: Callable[[Record], None] = lambda record: None,
) -> Summary:
    """Process scans, and store them in a catalogue, failures included.

    Scans that the catalogue has already are skipped. A script that calls this function needs the guard ``if
    __name__ == "__main__":``, because worker processes are spawned.

    Parameters
    ----------
    paths : str, Path, or a sequence of them
        Files, folders, globs, or manifests (``.txt``, ``.csv``).
    catalogue : Catalogue, str or Path
        The catalogue in which the shapes are stored. A file that does not exist is created.
    labels : str, Path or mapping, optional
        The classes: a CSV file with the columns ``file`` and ``class``, a ``.cla`` file of the Princeton
        Shape Benchmark, or a mapping of names to classes.
    options : OptionsLike, optional
        The options of a new catalogue. By default the options of an existing catalogue, or the defaults.
    workers : int, optional
        Largest number of scans that are processed at a time. By default one for each core.
    timeout : float, default 600
        Longest time for one shape; seconds.
    memory : float, optional
        Largest heap of one worker; GiB. By default there is no limit.
    executor : Executor or str, default "processes"
        The executor that processes the scans, or its name. The default runs worker processes on this
        computer, so that a scan that hangs, crashes or exhausts the memory does not affect other scans.
    retry_failed : bool, default False
        Whether scans that failed before are processed again.
    on_shape : function, optional
        Called with the record of each shape as soon as it is stored, or skipped.

    Returns
    -------
    Summary
        The records of all scans: done, failed and skipped.

    Raises
    ------
    InputError
        If a path does not exist, or names no scans.
    BenchmarkError
        If the labels cannot be read, or contradict each other.
    OptionError
        If there is no such option, or no such executor.
    CatalogueError
        If the catalogue was built with other options, or cannot be opened.
    """
    beside = [path for path in (labels, catalogue) if isinstance(path, (str, Path))]
    scans = discover([paths] if isinstance(paths, (str, Path)) else paths, beside)
    names = read_labels(labels) if isinstance(labels, (str, Path)) else labels
    chosen = None if options is None else PipelineOptions.of(options)
    with _opened(catalogue, chosen, create=True) as store:
        return ingest_files(
            scans,
            store,
            labels=names,
            workers=workers,
            timeout=timeout,
            memory=memory,
            executor=executor,
            retry_failed=retry_failed,
            on_shape=on_shape,
        )


def search(
    catalogue: CatalogueLike,
    query: ScanLike | Signature,
    *,
    k: int = 10,
    options: OptionsLike = None,
    matrix: DistanceMatrix | None = None,
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

    Returns
    -------
    Neighbors
        Nearest first; equal distances by id.

    Raises
    ------
    CatalogueError
        If the options require other spectra than the catalogue has.
    InputError
        If the catalogue has no shapes; or, with `matrix`, does not have this query.
    ShapeError
        If the scan cannot be read or has no usable surface.
    """
    with _opened(catalogue) as store:
        chosen = PipelineOptions.of(options, store.options)
        if not isinstance(query, (str, Path, Signature)):
            made = describe(process(query, store.options), chosen.compared)
            query = replace(made, digest=chosen.compared_digest)
        return search_catalogue(store, query, k=k, options=chosen, matrix=matrix)


def inspect(
    scan: ScanLike, options: OptionsLike = None, *, n_rescans: int = 4, page: str | Path | None = None
) -> Inspection:
    """Process a scan, and check the result of each stage.

    Parameters
    ----------
    scan : ScanLike
        A path, an array or geometry.
    options : OptionsLike, optional
        Options, a preset's name, a TOML file, or a mapping.
    n_rescans : int, default 4
        Number of surfaces that are reconstructed from nine tenths of the points, for the rescan deviation of
        the signature; 0 for none.
    page : str or Path, optional
        An HTML file to which a page with the results is written.

    Returns
    -------
    Inspection
        Points, normals, surface, checks and signature; those of the earlier stages if a stage fails.

    Raises
    ------
    InputError
        If `scan` cannot be converted to a cloud or a mesh, or the page cannot be written.
    """
    found = inspect_scan(scan, options, n_rescans=n_rescans)
    if page is not None:
        write_inspection_page(found, page)
    return found


def evaluate(
    shapes: CatalogueLike | SignatureTable,
    *,
    options: OptionsLike = None,
    labels: str | Path | None = None,
    matrix: DistanceMatrix | None = None,
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
    with _opened(shapes) as store:
        chosen = PipelineOptions.of(options, store.options)
        return evaluate_rankings(rank_catalogue(store, chosen, labels=labels, matrix=matrix).rankings)


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
    with _opened(catalogue) as store:
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
    with _opened(catalogue) as store:
        chosen = PipelineOptions.of(options, store.options)
        return retrieval_page(store, path, n_queries=n_queries, k=k, options=chosen, matrix=matrix)


def merge_views(
    views: str | Path | Sequence[ScanLike],
    options: MergeOptions | Mapping[str, object] | None = None,
    *,
    on_pair: Callable[[int, int], None] | None = None,
) -> Merged:
    """Register range scans of one body, and merge them into one cloud.

    Parameters
    ----------
    views : str, Path, or a sequence of ScanLike
        A folder, a glob or a Stanford ``.conf`` file; or the views, each a file, an array or geometry.
    options : MergeOptions or mapping, optional
        The parameters of the registration. By default the defaults.
    on_pair : function, optional
        Called with the number of pairs of views that have been matched, and the number of all pairs.

    Returns
    -------
    Merged
        The merged cloud, the poses, and the overlaps and residuals of the views.

    Raises
    ------
    InputError
        If there are fewer than two views.
    OptionError
        If an option does not exist, or its value is not allowed.
    ReconstructionError
        If no two views share a surface.
    """
    chosen = options if isinstance(options, MergeOptions) else MergeOptions(**(options or {}))
    named = [views] if isinstance(views, (str, Path)) else views
    files = [view for view in named if isinstance(view, (str, Path))]
    if len(files) == len(named):
        read = read_views(files)
        return merge_clouds(read.clouds, chosen, poses=read.poses, on_pair=on_pair)
    return merge_clouds([as_cloud(as_scan(view)) for view in named], chosen, on_pair=on_pair)


@contextmanager
def _opened(
    catalogue: CatalogueLike, options: PipelineOptions | None = None, *, create: bool = False
) -> Iterator[Catalogue]:
    """The catalogue. If a path is given, it is opened and closed again."""
    if isinstance(catalogue, Catalogue):
        yield catalogue
    else:
        with Catalogue(catalogue, options, create=create) as store:
            yield store
