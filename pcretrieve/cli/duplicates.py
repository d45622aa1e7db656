"""The command that finds pairs of shapes that are nearer than the noise: duplicates."""

from __future__ import annotations

from typing import Any

import click

from pcretrieve.cli.commands import command
from pcretrieve.cli.comparison import compared, comparison_options
from pcretrieve.cli.documents import write_document
from pcretrieve.cli.messages import say
from pcretrieve.cli.parts import catalogue_option, json_option
from pcretrieve.cli.tables import Column, write_table

__all__ = ["duplicates_command"]


@command("duplicates")
@catalogue_option
@click.option(
    "--threshold",
    type=click.FloatRange(min=0),
    metavar="DISTANCE",
    help="Largest distance of a pair.  [default: by both uncertainties]",
)
@comparison_options
@json_option
def duplicates_command(catalogue: str, threshold: float | None, as_json: bool, **comparison: Any) -> None:
    """Find pairs of shapes that are nearer than the noise, such as two scans of one body in one pose.

    Printed are the distance, its limit and both ids, nearest first. Without --threshold, distances are those
    of log-signatures without whitening, and doubtful shapes are left out.

    \b
    pcretrieve duplicates --catalogue bodies.sqlite
    """
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.query import duplicates

    with Catalogue(catalogue) as store:
        options = compared(store, **comparison)
        pairs = duplicates(store, options=options, threshold=threshold)
    if as_json:
        write_document([pair._asdict() for pair in pairs], options=options)
        return
    write_table(
        (Column("DISTANCE", "number"), Column("LIMIT", "number"), Column("FIRST"), Column("SECOND")),
        ((f"{one.distance:#.4g}", f"{one.limit:#.4g}", one.first, one.second) for one in pairs),
    )
    say(f"{len(pairs)} {'pair' if len(pairs) == 1 else 'pairs'}")
