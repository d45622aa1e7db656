"""The command that writes distance matrices: matrix."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import click

from pcretrieve.cli.commands import command, option
from pcretrieve.cli.comparison import RecordName, compared, comparison_options, given_flags, names_of
from pcretrieve.cli.documents import write_document
from pcretrieve.cli.messages import say
from pcretrieve.cli.parts import EXIT_SOME_FAILED, catalogue_option, json_option

__all__ = ["matrix_command"]


@command("matrix")
@catalogue_option
@option(
    "--output",
    "-o",
    type=click.Path(path_type=Path),
    required=True,
    metavar="FILE",
    help="The matrix: .npy, or plain text.",
    details="The ids of its rows are written to a file beside it, one in each line.",
)
@option(
    "--matcher",
    type=RecordName("matcher"),
    help="Compare pairs of surfaces instead of signatures.",
    details=partial(names_of, "matcher"),
)
@comparison_options
@json_option
def matrix_command(
    catalogue: str, output: Path, matcher: str | None, as_json: bool, **comparison: Any
) -> None:
    """Write the distance matrix of a catalogue, in the format of the SHREC (Shape Retrieval Contest) tracks.

    The value in row i and column j is the distance from the query i to the shape j. Shapes that the matcher
    cannot be applied to are reported and left out. Distances are written without re-ranking, which `evaluate
    --matrix` applies to them.

    \b
    pcretrieve matrix --catalogue bodies.sqlite -o bodies.txt
    pcretrieve evaluate --catalogue bodies.sqlite --matrix bodies.txt
    """
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.evaluation import catalogue_distances
    from pcretrieve.matching import ids_path, write_matrix

    if matcher is not None and (given := given_flags(comparison)):
        raise click.UsageError(f"a matcher has no signatures: leave out {given}")
    if comparison["rerank"] is not None:
        raise click.UsageError("distances are not re-ranked: leave out --rerank, and give it to `evaluate`")
    with Catalogue(catalogue) as store:
        options = compared(store, **comparison)
        matrix, failures = catalogue_distances(store, options, matcher=matcher)
    write_matrix(matrix, output)
    for failure in failures:
        say(f"failed: [{failure.shape_id} / {failure.stage}] {failure.message}")
    say(f"{len(matrix)} shapes: distances in {output}, ids in {ids_path(output)}")
    if as_json:
        failed = [
            {"id": one.shape_id, "error": type(one).__name__, "stage": one.stage, "message": one.message}
            for one in failures
        ]
        files = {"matrix": str(output), "ids": str(ids_path(output))}
        write_document(files | {"n_shapes": len(matrix), "failed": failed}, options=options)
    if failures:
        click.get_current_context().exit(EXIT_SOME_FAILED)
