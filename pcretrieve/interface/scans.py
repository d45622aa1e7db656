"""Scans → catalogue, findings, or one cloud: `ingest`, `inspect` and `merge_views`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path

from pcretrieve.catalogue import CatalogueLike, Record, opened, stored_records
from pcretrieve.formats import ScanLike, as_scan
from pcretrieve.ingestion import EXECUTORS, Executor
from pcretrieve.ingestion.layouts import discover_labelled
from pcretrieve.ingestion.run import Summary, ingest_files, plan_files
from pcretrieve.ingestion.shards import scans_of
from pcretrieve.ingestion.views import read_views
from pcretrieve.inspection import Inspection, inspect_scan
from pcretrieve.options import MergeOptions, OptionsLike, PipelineOptions
from pcretrieve.points.register import Merged
from pcretrieve.points.register import merge_views as merge_clouds
from pcretrieve.values.conversion import as_cloud

__all__ = ["ingest", "inspect", "merge_views"]


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
    retries: int = 0,
    max_failures: int | None = None,
    dry_run: bool = False,
    shard: str | None = None,
    on_start: Callable[[int], None] = lambda number: None,
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
        Shape Benchmark, a mapping of names to classes, or the name of a layout: ``shrec11``,
        ``shrec14-real``, ``shrec14-synthetic``, ``faust``, ``tosca``, ``psb``, ``folders`` or ``csv``.
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
    retries : int, default 0
        Number of further attempts at a scan that fails, after all other scans: in a new process, then with
        cheaper settings, then by the other method of surface reconstruction. What was changed is in the
        provenance of the shape, in the step ``retry``.
    max_failures : int, optional
        Number of scans that may fail in this run before it stops. By default all of them.
    dry_run : bool, default False
        Whether nothing is processed and stored: the summary has what would be done.
    shard : str, optional
        ``I/N``: process the I-th of N parts of the scans only, each into a catalogue of its own, from which
        `merge_catalogues` makes the catalogue of all. The part of a scan depends on its content.
    on_start : function, optional
        Called with the number of scans before the first of them is processed.
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
    PcretrieveError
        If `max_failures` scans have failed.
    """
    scans, names = discover_labelled(
        [paths] if isinstance(paths, (str, Path)) else paths,
        labels if isinstance(labels, (str, Path)) else None,
        [catalogue] if isinstance(catalogue, (str, Path)) else [],
    )
    chosen = None if options is None else PipelineOptions.of(options)
    runs = EXECUTORS[executor] if isinstance(executor, str) else executor
    classes = labels if isinstance(labels, Mapping) else names
    part = scans_of(shard, scans)
    on_start(len(part))
    if dry_run:
        records = stored_records(catalogue, chosen)
        return plan_files(
            scans,
            records,
            labels=classes,
            timeout=timeout,
            retry_failed=retry_failed,
            only=part,
            on_shape=on_shape,
        )
    with opened(catalogue, chosen, create=True) as store:
        return ingest_files(
            scans,
            store,
            labels=classes,
            workers=workers,
            timeout=timeout,
            memory=memory,
            executor=runs,
            retry_failed=retry_failed,
            retries=retries,
            max_failures=max_failures,
            only=part,
            on_shape=on_shape,
        )


def inspect(
    scan: ScanLike,
    options: OptionsLike = None,
    *,
    n_rescans: int = 4,
    page: str | Path | None = None,
    catalogue: CatalogueLike | None = None,
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
    catalogue : Catalogue, str or Path, optional
        Where the next body is looked for, with whose distance the error bar of the signature is compared; its
        options are then the defaults. Without a catalogue, this distance is that of people.

    Returns
    -------
    Inspection
        Points, normals, surface, checks and signature; those of the earlier stages if a stage fails.

    Raises
    ------
    InputError
        If `scan` cannot be converted to a cloud or a mesh, or the page cannot be written.
    CatalogueError
        If the options require other spectra than the catalogue has.
    """
    with nullcontext() if catalogue is None else opened(catalogue) as store:
        found = inspect_scan(scan, options, n_rescans=n_rescans, catalogue=store)
    if page is not None:
        from pcretrieve.pages import write_inspection_page

        write_inspection_page(found, page)
    return found


def merge_views(
    views: str | Path | Sequence[ScanLike],
    options: MergeOptions | Mapping[str, object] | str | Path | None = None,
    *,
    on_pair: Callable[[int, int], None] | None = None,
) -> Merged:
    """Register range scans of one body, and merge them into one cloud.

    Parameters
    ----------
    views : str, Path, or a sequence of ScanLike
        A folder, a glob or a Stanford ``.conf`` file; or the views, each a file, an array or geometry.
    options : MergeOptions, mapping, str or Path, optional
        The parameters of the registration, or the name of a preset or of a TOML file that has them in the
        table ``[merge]``. By default the defaults.
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
    if isinstance(options, (str, Path)):
        options = PipelineOptions.named(options).merge
    chosen = options if isinstance(options, MergeOptions) else MergeOptions(**(options or {}))
    named = [views] if isinstance(views, (str, Path)) else views
    files = [view for view in named if isinstance(view, (str, Path))]
    if len(files) == len(named):
        read = read_views(files)
        return merge_clouds(read.clouds, chosen, poses=read.poses, on_pair=on_pair)
    return merge_clouds([as_cloud(as_scan(view)) for view in named], chosen, on_pair=on_pair)
