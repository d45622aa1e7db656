"""The command that checks whether a catalogue is whole: check."""

from __future__ import annotations

import sys
from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING

import click

from pcretrieve.cli.commands import command
from pcretrieve.cli.documents import write_document
from pcretrieve.cli.messages import say, without_password, write_words
from pcretrieve.cli.parts import catalogue_argument, json_option
from pcretrieve.cli.progress import Progress
from pcretrieve.cli.tables import Column, write_table

if TYPE_CHECKING:
    from pcretrieve.interface.maintenance import Check

__all__ = ["check_command"]

EXIT_DEFECTS = 1


@command("check")
@catalogue_argument
@click.option(
    "--sample",
    type=click.IntRange(min=0),
    default=10,
    show_default=True,
    metavar="N",
    help="Number of signatures that are computed again, from stored surfaces or from unchanged files.",
)
@click.option(
    "--repair",
    is_flag=True,
    help="Remove rows of no shape and damaged indexes, make SQL indexes again, and set damaged shapes to be "
    "ingested again.",
)
@json_option
def check_command(catalogue: str, sample: int, repair: bool, as_json: bool) -> None:
    """Check whether a catalogue is whole: its file, each record, all arrays, and a sample of signatures.

    The exit code is 1 if there is a defect that was not repaired.

    \b
    pcretrieve check bodies.sqlite --repair
    """
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.interface import check

    with Catalogue(catalogue) as store:
        n_rows = len(store) + sum(store.failures().values())
        with Progress("check", n_rows, "bar") as progress:
            result = check(store, sample=sample, repair=repair, on_shapes=partial(_advance, progress))
    if as_json:
        document = {"catalogue": without_password(catalogue), "is_whole": result.is_whole} | asdict(result)
        write_document(document, options=store.options)
    else:
        _write(catalogue, result)
    if not result.is_whole:
        sys.exit(EXIT_DEFECTS)


def _advance(progress: Progress, n_shapes: int) -> None:
    for _ in range(n_shapes):
        progress.advance({})


def _write(catalogue: str, result: Check) -> None:
    write_table(
        (Column("SHAPE"), Column("DEFECT", "words"), Column("REPAIR", "words")),
        ((one.shape_id or "-", one.message, one.repair or "not repaired") for one in result.defects),
    )
    if any(defect.kind == "database" and not defect.repair for defect in result.defects):
        say(
            "the file is damaged in a way that cannot be repaired: restore a backup, or ingest into a new one"
        )
    n_defects, n_left = len(result.defects), sum(defect.repair is None for defect in result.defects)
    write_words(
        f"{catalogue}: {result.n_shapes} shapes, {result.n_failed} failed, {result.n_recomputed} signatures "
        f"computed again, {n_defects} defects" + (f", {n_left} not repaired" if n_left else "")
    )
