"""The command that processes scans and stores them in a catalogue: ingest."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pcretrieve.cli.comparison import RecordName
from pcretrieve.cli.messages import failure_line, say, write_json
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

if TYPE_CHECKING:
    from pcretrieve.catalogue import Record

__all__ = ["ingest_command"]

# Largest number of names in the message about names in a label file that match no scan.
QUOTED = 5


@click.command("ingest")
@click.argument("paths", nargs=-1, metavar="PATH...")
@catalogue_option
@click.option(
    "--labels",
    metavar="CSV|LAYOUT",
    help="Classes: a CSV file with the columns file and class; a .cla file of the Princeton Shape Benchmark; "
    "or a layout: shrec11, shrec14-real, shrec14-synthetic, faust, tosca and psb are published sets; folders "
    "are named like their class; csv is labels.csv beside the scans.",
)
@config_option
@surface_option
@unit_option
@click.option(
    "--no-meshes",
    is_flag=True,
    help="Leave meshes out of a new catalogue: a scan then takes some 60 kB, and not some 350 kB. Pages have "
    "no pictures, nothing can be exported, and descriptors of surfaces other than those of the spectrum "
    "cannot be computed.",
)
@click.option(
    "--workers",
    type=click.IntRange(min=1),
    show_default="one per core",
    metavar="N",
)
@limit_options("scan")
@click.option(
    "--executor",
    type=RecordName("executor"),
    default="processes",
    show_default=True,
    help="What processes the scans.",
)
@click.option("--retry-failed", is_flag=True, help="Process scans again that failed before.")
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
    retry_failed: bool,
    as_json: bool,
) -> None:
    """Process scans, and store them in a catalogue.

    PATH is a file, a folder, a glob pattern, or a manifest (.txt, .csv) with the paths of files. Scans that
    the catalogue has already are skipped: after an interruption, the same command continues.

    \b
    pcretrieve ingest scans/ --labels scans/labels.csv --catalogue bodies.sqlite
    pcretrieve ingest 'tosca/*.off' --surface keep --catalogue tosca.sqlite
    """
    from tqdm import tqdm

    from pcretrieve.catalogue import Catalogue
    from pcretrieve.ingestion.discover import printable
    from pcretrieve.ingestion.executors import EXECUTORS
    from pcretrieve.ingestion.layouts import discover_labelled
    from pcretrieve.ingestion.run import ingest_files

    if not paths:
        raise click.UsageError("name at least one scan")
    scans, names = discover_labelled(paths, labels, [catalogue])
    runs = EXECUTORS[executor]
    # Without --config, --surface and --unit, the options of an existing catalogue are used.
    options = None
    if config or surface or unit or no_meshes:
        options = load_options(config, surface)
    if options and unit:
        options = options.changed(scan={"unit": unit})
    if options and no_meshes:
        options = options.changed(catalogue={"keep": set(options.catalogue.keep) - {"meshes"}})
    with (
        Catalogue(catalogue, options, create=True) as store,
        tqdm(total=len(scans), unit="scan", desc="ingest", disable=None) as bar,
    ):
        n_failed = 0

        def advance(record: Record) -> None:
            nonlocal n_failed
            if record.status == "failed":
                n_failed += 1
                tqdm.write(failure_line(record), file=sys.stderr)
            bar.set_postfix(failed=n_failed, refresh=False)
            bar.update()

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
                on_shape=advance,
            )
        except (KeyboardInterrupt, SystemExit) as stop:
            bar.close()
            say(f"stopped; {len(store)} shapes are in {catalogue}, and the same command goes on from there")
            sys.exit(stop.code if isinstance(stop, SystemExit) else EXIT_INTERRUPTED)
    held_failed = [record for record in summary.held if record.status == "failed"]
    duplicates = [(printable(path), original) for path, original in summary.duplicates]
    for path, original in duplicates:
        say(f"skipped {path}: the same content as {original.id} ({original.path})")
    if summary.unknown_labels:
        quoted = ", ".join(summary.unknown_labels[:QUOTED])
        more = len(summary.unknown_labels) - QUOTED
        say(
            f"{labels} names {len(summary.unknown_labels)} shapes that are not among the scans: {quoted}"
            + (f" and {more} more" if more > 0 else "")
        )
    failures = summary.failed + held_failed
    say(
        f"{len(summary.done)} done, {len(failures)} failed, {len(summary.held) - len(held_failed)} held "
        f"already, {len(duplicates)} duplicates: {catalogue}"
        + ("; --retry-failed processes the failed shapes again" if failures else "")
    )
    doubts = [record for record in (*summary.done, *summary.held) if record.is_doubtful]
    if doubts:
        n_unusable = sum(record.verdict.judgement == "unusable" for record in doubts if record.verdict)
        say(
            f"{len(doubts) - n_unusable} doubtful, {n_unusable} unusable by the checks of their scans: "
            "`pcretrieve list --doubtful` gives the reasons"
        )
    if as_json:
        write_json(
            {
                "catalogue": str(catalogue),
                "done": [record.id for record in summary.done],
                "held": [record.id for record in summary.held if record.status == "done"],
                "doubtful": [record.id for record in doubts],
                "duplicates": [{"path": path, "id": original.id} for path, original in duplicates],
                "failed": [
                    {
                        "id": record.id,
                        "path": record.path,
                        "stage": record.stage,
                        "error": record.error,
                        "message": record.message,
                    }
                    for record in failures
                ],
                "unknown_labels": summary.unknown_labels,
            }
        )
    if failures:
        click.get_current_context().exit(EXIT_SOME_FAILED)
