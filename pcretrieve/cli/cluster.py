"""The command that groups the shapes of a catalogue without labels: cluster."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from pcretrieve.cli.commands import command
from pcretrieve.cli.comparison import compared, comparison_options
from pcretrieve.cli.documents import write_document
from pcretrieve.cli.messages import say, write_csv
from pcretrieve.cli.parts import catalogue_option, json_option
from pcretrieve.cli.tables import Column, write_table

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
    help="The file to write.  [default: standard output; a terminal shows a table]",
)
@comparison_options
@json_option
def cluster_command(
    catalogue: str, min_size: int, output: Path | None, as_json: bool, **comparison: Any
) -> None:
    """Group the shapes of a catalogue without labels, by the density of their signatures (HDBSCAN).

    The default whitening does not use labels. The table has the columns id and label; shapes in no cluster
    have no label.

    \b
    pcretrieve cluster --catalogue bodies.sqlite -o clusters.csv
    """
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.query import cluster
    from pcretrieve.values.files import csv_text, write_file

    with Catalogue(catalogue) as store:
        options = compared(store, **comparison)
        labels = cluster(store, options=options, min_size=min_size)
    text = csv_text(("id", "label"), labels.items())
    if output is not None:
        write_file(output, text.encode())
    if as_json:
        document = [{"id": shape_id, "label": label} for shape_id, label in labels.items()]
        write_document(document, options=options)
    elif output is None and sys.stdout.isatty():
        write_table(
            (Column("ID"), Column("CLUSTER")), ((name, label or "-") for name, label in labels.items())
        )
    elif output is None:
        write_csv(text)
    n_none = sum(label is None for label in labels.values())
    say(f"{len({*labels.values()} - {None})} clusters of {len(labels)} shapes, {n_none} of them in none")
