"""The command that processes scans and stores them in a catalogue: ingest."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pcretrieve.cli.commands import command, option
from pcretrieve.cli.comparison import RecordName, names_of
from pcretrieve.cli.documents import write_document
from pcretrieve.cli.messages import failure_line, log_to, say
from pcretrieve.cli.parts import (
    EXIT_INTERRUPTED,
    EXIT_SOME_FAILED,
    catalogue_option,
    config_option,
    json_option,
    limit_options,
    load_options,
    surface_option,
    unit_option,
)
from pcretrieve.cli.progress import Progress, progress_option
from pcretrieve.cli.scans import workers_option
from pcretrieve.cli.summary import record_facts, say_summary, summary_document

if TYPE_CHECKING:
    from pcretrieve.catalogue import Record

__all__ = ["ingest_command"]


@command("ingest")
@click.argument("paths", nargs=-1, metavar="PATH...")
@catalogue_option
@option(
    "--labels",
    metavar="CSV|LAYOUT",
    help="Classes: a CSV file (columns file, class), a .cla file, or folders (named like classes), csv "
    "(labels.csv beside scans), shrec11, shrec14-real, shrec14-synthetic, faust, tosca, psb.",
)
@config_option
@surface_option
@unit_option
@option(
    "--no-meshes",
    is_flag=True,
    rare=True,
    help="Leave meshes out of a new catalogue: a scan then takes some 60 kB, and not some 350 kB. Pages have "
    "no pictures, nothing can be exported, and descriptors of surfaces other than those of the spectrum "
    "cannot be computed.",
)
@workers_option
@limit_options("scan")
@option(
    "--executor",
    type=RecordName("executor"),
    rare=True,
    default="processes",
    show_default=True,
    help="What processes the scans.",
    details=partial(names_of, "executor"),
)
@option(
    "--scheduler",
    metavar="ADDRESS",
    rare=True,
    help="Process the scans by the Dask cluster of this scheduler.",
)
@option(
    "--scheduler-file",
    type=click.Path(path_type=Path),
    metavar="FILE",
    rare=True,
    help="The same, by the file that `dask scheduler --scheduler-file` writes.",
)
@option(
    "--cluster",
    type=click.Choice(["local"]),
    rare=True,
    help="Process the scans by a Dask cluster that is started on this computer, for trials.",
)
@option("--retry-failed", is_flag=True, help="Process scans again that failed before.")
@option(
    "--retries",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    metavar="N",
    help="Try failing scans again, with changes.",
    details="N times at most, after all other scans: in a new process, then with cheaper settings, then by "
    "the other method of surface reconstruction. `pcretrieve show` says what was changed.",
)
@option(
    "--max-failures",
    type=click.IntRange(min=1),
    metavar="N",
    rare=True,
    help="Stop after N scans have failed. The same command goes on from there.",
)
@option("--dry-run", is_flag=True, help="Say what would be done, and do nothing.")
@progress_option
@option("--quiet", "-q", is_flag=True, help="Print warnings and failures only.")
@option(
    "--log-file",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Append each stage of each scan to a file.",
    details="With repairs and fallbacks.",
)
@option(
    "--shard",
    metavar="I/N",
    rare=True,
    help="Process the I-th of N parts of the scans only, as a task of a job array; `catalogue merge` makes "
    "one catalogue of all parts.",
)
@json_option
def ingest_command(
    paths: tuple[str, ...],
    catalogue: str,
    labels: str | None,
    config: Path | None,
    surface: str | None,
    unit: str | None,
    no_meshes: bool,
    workers: int | None,
    timeout: float,
    memory: float | None,
    executor: str,
    scheduler: str | None,
    scheduler_file: Path | None,
    cluster: str | None,
    retry_failed: bool,
    retries: int,
    max_failures: int | None,
    dry_run: bool,
    progress: str,
    quiet: bool,
    log_file: Path | None,
    shard: str | None,
    as_json: bool,
) -> None:
    """Process scans, and store them in a catalogue.

    PATH is a file, a folder, a glob pattern, or a manifest (.txt, .csv) with the paths of files. Scans that
    the catalogue has already are skipped: after an interruption, the same command continues.

    \b
    pcretrieve ingest scans/ --labels scans/labels.csv --catalogue bodies.sqlite
    pcretrieve ingest 'tosca/*.off' --surface keep --catalogue tosca.sqlite
    """
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.ingestion.cluster import DaskExecutor
    from pcretrieve.ingestion.executors import EXECUTORS
    from pcretrieve.ingestion.layouts import discover_labelled
    from pcretrieve.ingestion.run import ingest_files, plan_files
    from pcretrieve.ingestion.shards import scans_of
    from pcretrieve.interface.catalogues import stored_records

    if not paths:
        raise click.UsageError("name at least one scan")
    if log_file is not None:
        log_to(log_file)
    scans, names = discover_labelled(paths, labels, [catalogue])
    part = scans_of(shard, scans)
    runs = EXECUTORS[executor]
    if scheduler or scheduler_file or cluster:
        runs = DaskExecutor(scheduler, scheduler_file, cluster == "local")
    # Without --config, --surface and --unit, the options of an existing catalogue are used.
    options = None
    if config or surface or unit or no_meshes:
        options = load_options(config, surface)
    if options and unit:
        options = options.changed(scan={"unit": unit})
    if options and no_meshes:
        options = options.changed(catalogue={"keep": set(options.catalogue.keep) - {"meshes"}})
    with Progress("ingest", len(part), "none" if quiet and progress == "bar" else progress) as shown:

        def advance(record: Record) -> None:
            failure = failure_line(record) if record.status == "failed" else None
            shown.advance(record_facts(record), failure)

        used = options
        if dry_run:
            summary = plan_files(
                scans,
                stored_records(catalogue, options),
                labels=names,
                timeout=timeout,
                retry_failed=retry_failed,
                only=part,
                on_shape=advance,
            )
        else:
            with Catalogue(catalogue, options, create=True) as store:
                used = store.options
                try:
                    summary = ingest_files(
                        scans,
                        store,
                        labels=names,
                        workers=workers,
                        timeout=timeout,
                        memory=memory,
                        executor=runs,
                        retry_failed=retry_failed,
                        retries=retries,
                        max_failures=max_failures,
                        only=part,
                        on_shape=advance,
                    )
                except (KeyboardInterrupt, SystemExit) as stop:
                    shown.close()
                    n = len(store)
                    say(f"stopped; {n} shapes are in {catalogue}, and the same command goes on from there")
                    sys.exit(stop.code if isinstance(stop, SystemExit) else EXIT_INTERRUPTED)
    if not quiet:
        say_summary(summary, catalogue, labels)
    if as_json:
        write_document(summary_document(summary, catalogue), options=used)
    if any(record.status == "failed" for record in (*summary.failed, *summary.held)):
        click.get_current_context().exit(EXIT_SOME_FAILED)
