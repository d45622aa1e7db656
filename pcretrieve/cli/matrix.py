"""The command that writes distance matrices: matrix."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from pcretrieve.cli.parts import catalogue_option, compared, comparison_options, say

__all__ = ["matrix_command"]


@click.command("matrix")
@catalogue_option
@click.option(
    "--output",
    "-o",
    type=click.Path(path_type=Path),
    required=True,
    metavar="FILE",
    help="The matrix: .npy, or any other suffix for plain text. Its ids go to a file beside it, one a line.",
)
@comparison_options
def matrix_command(catalogue: Path, output: Path, **comparison: Any) -> None:
    """All distances between the shapes of a catalogue, as SHREC tracks ask for them.

    Row i, column j: the distance from shape i, as a query, to shape j.

    \b
    pcretrieve matrix --catalogue bodies.sqlite -o bodies.txt
    pcretrieve evaluate --catalogue bodies.sqlite --matrix bodies.txt
    """
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.matching import distance_matrix, ids_path, write_matrix
    from pcretrieve.retrieval import SignatureIndex

    with Catalogue(catalogue) as store:
        options = compared(store, **comparison)
        index = SignatureIndex(
            store.signatures(options), options.retrieval, whitening=store.whitening(options)
        )
    matrix = distance_matrix(index)
    write_matrix(matrix, output)
    say(f"{len(matrix)} shapes: distances in {output}, ids in {ids_path(output)}")
