"""The command that writes the retrieval page: report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from pcretrieve.cli.parts import (
    catalogue_option,
    distance_option,
    method_option,
    n_values_option,
    scale_option,
    size_weight_option,
    whitening_option,
)
from pcretrieve.cli.signature_choice import signature_options

if TYPE_CHECKING:
    pass

__all__ = ["report_command"]


@click.command("report")
@catalogue_option
@click.option(
    "--output",
    "-o",
    type=click.Path(path_type=Path),
    required=True,
    metavar="PAGE",
    help="The HTML page to write.",
)
@click.option(
    "--queries", type=click.IntRange(min=1), default=8, show_default=True, help="Rows of results, most."
)
@click.option("-k", "k", type=click.IntRange(min=1), default=5, show_default=True, help="Results in a row.")
@distance_option
@whitening_option
@method_option
@n_values_option
@scale_option
@size_weight_option
def report_command(
    catalogue: Path,
    output: Path,
    queries: int,
    k: int,
    distance: str,
    whitening: str,
    method: str | None,
    n_values: int | None,
    scale: str | None,
    size_weight: float | None,
) -> None:
    """An HTML page: retrieval measures, and pictures of queries and their ranked results.

    Queries are the first shape of each class, or of all where there are no classes.

    \b
    pcretrieve report --catalogue bodies.sqlite -o bodies.html
    """
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.pages.retrieval_page import retrieval_page

    with Catalogue(catalogue) as store:
        page = retrieval_page(
            store,
            output,
            n_queries=queries,
            k=k,
            distance=distance,
            whitening=whitening,
            options=signature_options(store, whitening, method, n_values, scale, size_weight),
        )
    click.echo(str(page))
