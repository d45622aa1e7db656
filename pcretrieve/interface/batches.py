"""What goes on with a catalogue: `status`; failed shapes again: `retry`; scans that arrive: `watch`."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

from pcretrieve.catalogue import CatalogueLike, Record, opened
from pcretrieve.ingestion import EXECUTORS, BatchStatus, Executor
from pcretrieve.ingestion.arrivals import Arrivals
from pcretrieve.ingestion.batch import batch_status
from pcretrieve.ingestion.plan import failed_paths
from pcretrieve.ingestion.run import Summary, ingest_files
from pcretrieve.options import OptionsLike, PipelineOptions

__all__ = ["retry", "status", "watch"]


def status(catalogue: CatalogueLike) -> BatchStatus:
    """How far the last ingest into a catalogue is, which may be running, and what has failed.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The catalogue.

    Returns
    -------
    BatchStatus
        Rate, remaining time, share of each stage, and failures by kind.

    Raises
    ------
    CatalogueError
        If the catalogue cannot be opened.
    """
    with opened(catalogue) as store:
        return batch_status(store)


def retry(
    catalogue: CatalogueLike,
    *,
    stage: str | None = None,
    workers: int | None = None,
    timeout: float = 600.0,
    memory: float | None = None,
    executor: Executor | str = "processes",
    retries: int = 0,
    on_start: Callable[[int], None] = lambda number: None,
    on_shape: Callable[[Record], None] = lambda record: None,
) -> Summary:
    """Process the failed shapes of a catalogue again.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The catalogue.
    stage : str, optional
        Only shapes that failed in this stage, such as ``surface``, or ``worker`` for those whose process
        ended or exceeded its time limit.
    workers : int, optional
        As for `pcretrieve.ingest`.
    timeout : float, default 600
        As for `pcretrieve.ingest`; seconds.
    memory : float, optional
        As for `pcretrieve.ingest`; GiB.
    executor : Executor or str, default "processes"
        As for `pcretrieve.ingest`.
    retries : int, default 0
        As for `pcretrieve.ingest`.
    on_start : function, optional
        As for `pcretrieve.ingest`.
    on_shape : function, optional
        As for `pcretrieve.ingest`.

    Returns
    -------
    Summary
        The records of these shapes.

    Raises
    ------
    InputError
        If no shape failed in this stage.
    CatalogueError
        If the catalogue cannot be opened.
    """
    runs = EXECUTORS[executor] if isinstance(executor, str) else executor
    with opened(catalogue) as store:
        failed = failed_paths(store, stage)
        on_start(len(failed))
        return ingest_files(
            failed,
            store,
            workers=workers,
            timeout=timeout,
            memory=memory,
            executor=runs,
            retry_failed=True,
            retries=retries,
            on_shape=on_shape,
        )


def watch(
    folder: str | Path,
    catalogue: CatalogueLike,
    *,
    options: OptionsLike = None,
    interval: float = 5.0,
    workers: int | None = None,
    timeout: float = 600.0,
    memory: float | None = None,
    executor: Executor | str = "processes",
    retries: int = 0,
    on_shape: Callable[[Record], None] = lambda record: None,
) -> Iterator[Summary]:
    """Process the scans that are in a folder, and those that arrive, as soon as they stop growing.

    A file is processed when two looks have found it unchanged. One that changes afterwards is processed
    again, and replaces its earlier result.

    Parameters
    ----------
    folder : str or Path
        The folder, with its subfolders.
    catalogue : Catalogue, str or Path
        The catalogue in which the shapes are stored. A file that does not exist is created.
    options : OptionsLike, optional
        The options of a new catalogue. By default the options of an existing catalogue, or the defaults.
    interval : float, default 5
        Time between two looks into the folder; seconds.
    workers : int, optional
        As for `pcretrieve.ingest`.
    timeout : float, default 600
        As for `pcretrieve.ingest`; seconds.
    memory : float, optional
        As for `pcretrieve.ingest`; GiB.
    executor : Executor or str, default "processes"
        As for `pcretrieve.ingest`.
    retries : int, default 0
        As for `pcretrieve.ingest`.
    on_shape : function, optional
        As for `pcretrieve.ingest`.

    Yields
    ------
    Summary
        The records of the scans that have arrived together, after they were processed. There is no last one.

    Raises
    ------
    InputError
        If there is no such folder.
    OptionError
        If there is no such option, or no such executor.
    CatalogueError
        If the catalogue was built with other options, or cannot be opened or written.
    """
    arrivals = Arrivals(Path(folder))
    runs = EXECUTORS[executor] if isinstance(executor, str) else executor
    chosen = None if options is None else PipelineOptions.of(options)
    with opened(catalogue, chosen, create=True) as store:
        while True:
            if scans := arrivals.look():
                yield ingest_files(
                    scans,
                    store,
                    workers=workers,
                    timeout=timeout,
                    memory=memory,
                    executor=runs,
                    retries=retries,
                    on_shape=on_shape,
                )
            else:
                time.sleep(interval)
