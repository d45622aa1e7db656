"""The command that searches: query."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from pcretrieve.cli.parts import (
    catalogue_option,
    distance_option,
    json_option,
    method_option,
    n_values_option,
    scale_option,
    size_weight_option,
    whitening_option,
    write_json,
)
from pcretrieve.cli.signature_choice import signature_options

if TYPE_CHECKING:
    pass

__all__ = ["query_command"]


@click.command("query")
@click.argument("scan", type=click.Path(path_type=Path))
@catalogue_option
@click.option("-k", "k", type=click.IntRange(min=1), default=10, show_default=True, help="How many.")
@distance_option
@whitening_option
@method_option
@n_values_option
@scale_option
@size_weight_option
@json_option
def query_command(
    scan: Path,
    catalogue: Path,
    k: int,
    distance: str,
    whitening: str,
    method: str | None,
    n_values: int | None,
    scale: str | None,
    size_weight: float | None,
    as_json: bool,
) -> None:
    """The shapes most like a scan, nearest first.

    The scan is processed with the catalogue's own options; one that the catalogue holds is looked up.

    \b
    pcretrieve query --catalogue bodies.sqlite scan.ply -k 5 --whitening pca
    """
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.search import search

    with Catalogue(catalogue) as store:
        options = signature_options(store, whitening, method, n_values, scale, size_weight)
        neighbors = search(store, scan, k=k, distance=distance, whitening=whitening, options=options)
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
