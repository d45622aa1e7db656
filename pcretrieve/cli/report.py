"""The command that writes the retrieval page: report."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from pcretrieve.cli.commands import command
from pcretrieve.cli.comparison import compared, comparison_options, matrix_option, read_distances
from pcretrieve.cli.documents import write_document
from pcretrieve.cli.messages import shown_path, write_line
from pcretrieve.cli.parts import CATALOGUE, catalogue_option, json_option, up_option

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
    metavar="N",
    help="Largest number of queries, the worst first.  [default: 1000]",
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
@click.option(
    "--versus",
    type=CATALOGUE,
    metavar="RESULT",
    help="Compare with another result, query by query: queries.csv of `evaluate --csv`, or a catalogue.",
)
@up_option
@matrix_option
@comparison_options
@json_option
def report_command(
    catalogue: str,
    output: Path,
    queries: int | None,
    k: int,
    versus: str | None,
    up: str | None,
    matrix: Path | None,
    as_json: bool,
    **comparison: Any,
) -> None:
    """Write an HTML page with retrieval measures, and all queries with their nearest shapes, the worst first.

    The page has bars of the classes, confusion, a map, and the scans that failed. Queries are searched and
    sorted in it without a server.

    \b
    pcretrieve report --catalogue bodies.sqlite -o bodies.html
    pcretrieve evaluate --catalogue bodies.sqlite --whitening none --csv none/
    pcretrieve report -c bodies.sqlite --versus none/queries.csv -o bodies.html
    """
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.evaluation import result_scores
    from pcretrieve.pages.retrieval_page import MOST_QUERIES, retrieval_page

    distances = read_distances(matrix, comparison)
    with Catalogue(catalogue) as store:
        options = compared(store, **comparison)
        page = retrieval_page(
            store,
            output,
            n_queries=queries or MOST_QUERIES,
            k=k,
            options=options,
            matrix=distances,
            other=None if versus is None else result_scores(versus, lambda other: other.options),
            other_name=versus or "",
            up=up,
        )
    if as_json:
        write_document({"page": str(page)}, options=options)
    else:
        write_line(shown_path(str(page)))
