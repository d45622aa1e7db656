"""The command that writes the retrieval page: report."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from pcretrieve.cli.commands import command
from pcretrieve.cli.comparison import compared, comparison_options, matrix_option, read_distances
from pcretrieve.cli.documents import write_document
from pcretrieve.cli.messages import write_line
from pcretrieve.cli.parts import catalogue_option, json_option

__all__ = ["report_command"]


@command("report")
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
    "--queries",
    type=click.IntRange(min=1),
    default=8,
    show_default=True,
    metavar="N",
    help="Largest number of queries.",
)
@click.option(
    "-k",
    "k",
    type=click.IntRange(min=1),
    default=5,
    show_default=True,
    metavar="N",
    help="Number of results of each query.",
)
@matrix_option
@comparison_options
@json_option
def report_command(
    catalogue: str,
    output: Path,
    queries: int,
    k: int,
    matrix: Path | None,
    as_json: bool,
    **comparison: Any,
) -> None:
    """Write an HTML page with retrieval measures, and with pictures of queries and their ranked results.

    Queries are the first shape of each class, or the first shapes if there are no classes.

    \b
    pcretrieve report --catalogue bodies.sqlite -o bodies.html
    """
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.pages.retrieval_page import retrieval_page

    distances = read_distances(matrix, comparison)
    with Catalogue(catalogue) as store:
        options = compared(store, **comparison)
        page = retrieval_page(store, output, n_queries=queries, k=k, options=options, matrix=distances)
    if as_json:
        write_document({"page": str(page)}, options=options)
    else:
        write_line(str(page))
