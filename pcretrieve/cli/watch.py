"""The command that ingests the scans that arrive in a folder: watch."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pcretrieve.cli.commands import command
from pcretrieve.cli.messages import failure_line, say, shown_path
from pcretrieve.cli.parts import (
    EXIT_INTERRUPTED,
    catalogue_option,
    config_option,
    limit_options,
    load_options,
    surface_option,
    unit_option,
)
from pcretrieve.cli.patience import stop_waiting
from pcretrieve.cli.scans import workers_option
from pcretrieve.cli.summary import say_summary

if TYPE_CHECKING:
    from pcretrieve.catalogue import Record

__all__ = ["watch_command"]


@command("watch")
@click.argument("folder", type=click.Path(path_type=Path))
@catalogue_option
@config_option
@surface_option
@unit_option
@click.option(
    "--interval",
    type=click.FloatRange(min=0.1),
    default=5,
    show_default=True,
    metavar="SECONDS",
    help="Time between two looks, in which files must stay the same.",
)
@workers_option
@limit_options("scan")
def watch_command(
    folder: Path,
    catalogue: str,
    config: Path | None,
    surface: str | None,
    unit: str | None,
    interval: float,
    workers: int | None,
    timeout: float,
    memory: float | None,
) -> None:
    """Ingest the scans in a folder, and those that arrive, as soon as they stop growing; until Ctrl-C.

    \b
    pcretrieve watch scanner/ --catalogue bodies.sqlite
    """
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.interface.batches import watch

    options = None
    if config or surface or unit:
        options = load_options(config, surface)
    if options and unit:
        options = options.changed(scan={"unit": unit})

    def tell(record: Record) -> None:
        say(
            failure_line(record)
            if record.status == "failed"
            else f"done: [{record.id}] {shown_path(record.path)}"
        )

    with Catalogue(catalogue, options, create=True) as store:
        try:
            stop_waiting()
            say(f"watching {folder} every {interval:g} s, until Ctrl-C")
            rounds = watch(
                folder,
                store,
                interval=interval,
                workers=workers,
                timeout=timeout,
                memory=memory,
                on_shape=tell,
            )
            for summary in rounds:
                say_summary(summary, catalogue, None)
        except (KeyboardInterrupt, SystemExit) as stop:
            say(f"stopped; {len(store)} shapes are in {catalogue}, and the same command goes on from there")
            sys.exit(stop.code if isinstance(stop, SystemExit) else EXIT_INTERRUPTED)
