"""The command that searches: query."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from pcretrieve.cli.parts import (
    catalogue_option,
    compared,
    comparison_options,
    json_option,
    matrix_option,
    read_distances,
    write_json,
)

__all__ = ["query_command"]


@click.command("query")
@click.argument("scan", type=click.Path(path_type=Path))
@catalogue_option
@click.option("-k", "k", type=click.IntRange(min=1), default=10, show_default=True, help="How many.")
@matrix_option
@comparison_options
@json_option
def query_command(
    scan: Path,
    catalogue: Path,
    k: int,
    matrix: Path | None,
    as_json: bool,
    **comparison: Any,
) -> None:
    """The shapes most like a scan, nearest first.

    The scan is processed with the catalogue's own options; one that the catalogue holds is looked up.

    \b
    pcretrieve query --catalogue bodies.sqlite scan.ply -k 5 --whitening pca
    """
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.searching import search

    distances = read_distances(matrix, comparison)
    with Catalogue(catalogue) as store:
        options = compared(store, **comparison)
        neighbors = search(store, scan, k=k, options=options, matrix=distances)
        records = [store.record(shape_id) for shape_id in neighbors.ids]
    found = [
        {"rank": rank, "id": record.id, "path": record.path, "label": record.label, "distance": float(gap)}
        for rank, (record, gap) in enumerate(zip(records, neighbors.distances, strict=True), start=1)
    ]
    if as_json:
        write_json(found)
        return
    for row in found:
        click.echo(
            f"{row['rank']:>4}  {row['distance']:<10.4g}  {row['label'] or '-':<16}  {row['id']:<24}  "
            f"{row['path']}"
        )
