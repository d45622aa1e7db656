"""The command that processes the failed scans of a catalogue again: retry."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from pcretrieve.cli.commands import command
from pcretrieve.cli.documents import write_document
from pcretrieve.cli.messages import failure_line
from pcretrieve.cli.parts import EXIT_SOME_FAILED, catalogue_argument, json_option, limit_options
from pcretrieve.cli.progress import Progress, progress_option
from pcretrieve.cli.scans import workers_option
from pcretrieve.cli.summary import record_facts, say_summary, summary_document

if TYPE_CHECKING:
    from pcretrieve.catalogue import Record

__all__ = ["retry_command"]


@command("retry")
@catalogue_argument
@click.option(
    "--stage",
    metavar="STAGE",
    help="Only scans that failed in this stage, which `pcretrieve status` names; worker: whose process "
    "ended, or took too long.",
)
@click.option(
    "--retries",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    metavar="N",
    help="Try a scan that fails again, N times at most, with changes as for `ingest`.",
)
@workers_option
@limit_options("scan")
@progress_option
@json_option
def retry_command(
    catalogue: str,
    stage: str | None,
    retries: int,
    workers: int | None,
    timeout: float,
    memory: float | None,
    progress: str,
    as_json: bool,
) -> None:
    """Process the failed scans of a catalogue again, by its own options.

    \b
    pcretrieve retry bodies.sqlite --stage worker --timeout 3600
    """
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.interface.batches import retry

    with Catalogue(catalogue) as store:
        n_failed = sum(n for (place, _), n in store.failures().items() if stage in (None, place))
        with Progress("retry", n_failed, progress if n_failed else "none") as shown:

            def advance(record: Record) -> None:
                failure = failure_line(record) if record.status == "failed" else None
                shown.advance(record_facts(record), failure)

            summary = retry(
                store,
                stage=stage,
                workers=workers,
                timeout=timeout,
                memory=memory,
                retries=retries,
                on_shape=advance,
            )
    say_summary(summary, catalogue, None)
    if as_json:
        write_document(summary_document(summary, catalogue), options=store.options)
    if summary.failed:
        click.get_current_context().exit(EXIT_SOME_FAILED)
