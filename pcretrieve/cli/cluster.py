"""The command that groups the shapes of a catalogue without labels: cluster."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from pcretrieve.cli.commands import command
from pcretrieve.cli.comparison import compared, comparison_options
from pcretrieve.cli.messages import say, write_csv
from pcretrieve.cli.parts import catalogue_option
from pcretrieve.csv_text import csv_text

__all__ = ["cluster_command"]


@command("cluster")
@catalogue_option
@click.option(
    "--min-size",
    type=click.IntRange(min=2),
    default=3,
    show_default=True,
    metavar="N",
    help="Least number of shapes of a cluster.",
)
@click.option(
    "--output",
    "-o",
    type=click.Path(path_type=Path),
    metavar="CSV",
    help="The file to write.  [default: standard output]",
)
@comparison_options
def cluster_command(catalogue: str, min_size: int, output: Path | None, **comparison: Any) -> None:
    """Group the shapes of a catalogue without labels, by the density of their signatures (HDBSCAN).

    The default whitening does not use labels. The table has the columns id and label; shapes in no cluster
    have no label.

    \b
    pcretrieve cluster --catalogue bodies.sqlite -o clusters.csv
    """
    from pcretrieve.atomic import write_file
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.interface import cluster

    with Catalogue(catalogue) as store:
        labels = cluster(store, options=compared(store, **comparison), min_size=min_size)
    text = csv_text(("id", "label"), labels.items())
    if output is None:
        write_csv(text)
    else:
        write_file(output, text.encode())
    n_none = sum(label is None for label in labels.values())
    say(f"{len({*labels.values()} - {None})} clusters of {len(labels)} shapes, {n_none} of them in none")
